"""What a diagnosis says of robots whose faults are known, and what it works that out from."""

from dataclasses import replace

import numpy as np
import pytest

from tests.support.robots import PERIOD_S, arm_machine, arm_plant, recorded
from trueup.artifact.artifact import pack, unpack
from trueup.diagnose import problem_setup
from trueup.diagnose.candidate import Candidate
from trueup.diagnose.data_quality import assess
from trueup.diagnose.diagnosis import diagnose
from trueup.diagnose.explore import went_astray
from trueup.diagnose.figures import figures
from trueup.diagnose.locate import Strides, _pushed
from trueup.diagnose.problem_setup import Recordings, Setup
from trueup.diagnose.search import Search
from trueup.diagnose.spatial_periods import spatial_periods
from trueup.diagnose.summary_warnings import warnings
from trueup.diagnose.windowed_fits import trajectory
from trueup.episode.role import Role
from trueup.fit.base_parameters import directions
from trueup.fit.fitter import Fitter
from trueup.fit.identify import identify
from trueup.fit.residual import fit_residual
from trueup.model.block import BLOCK
from trueup.model.hypothesis import Hypothesis, switches
from trueup.model.predictor import Nominal, predict_observations
from trueup.model.roll import roll
from trueup.model.series import DECLARED, Scheme, mergeable, refined, seen_by, series
from trueup.model.windows import cut, starts_every
from trueup.simulate.robot import Follow, RobotPlan, rotor, run
from trueup_pages.diagnosis import report_page

pytestmark = pytest.mark.slow  # whole diagnoses, designs or installations

ROLES = ("adaptation", "adaptation", "validation")


def rubs(spec):
    spec.joint("elbow").frictionloss = 0.25


def carries(spec):
    spec.body("lower").add_geom(
        type=2, size=[0.03, 0, 0], pos=[0.3, 0, 0], mass=0.4, contype=0, conaffinity=0
    )


@pytest.fixture(scope="module")
def plant(tmp_path_factory):
    return arm_plant(tmp_path_factory.mktemp("arm"))


def test_a_payload_is_parameters_only(plant):
    document = diagnose(plant, recorded(plant, carries, range(3), ROLES, 1.5)).document
    assert document["verdict"] == "parameters_only"
    assert document["effects"] == []
    assert document["gap"]["closed"] > 0.95


def test_identified_and_residual_predict_a_payload_better_than_the_nominal_model(plant):
    episodes = recorded(plant, carries, range(4), ("adaptation",) * 3 + ("validation",))
    adaptation, test = episodes[:3], episodes[3]
    windows = cut(plant, test, starts_every(test.t_s, 0.5))

    def error(predictor):
        return float(
            np.sqrt(
                np.mean(
                    (predict_observations(predictor, windows) - test.observations[windows.rows])[
                        windows.inside
                    ]
                    ** 2
                )
            )
        )

    found, report = identify(plant, adaptation)
    assert report.health == ()
    assert error(found) < 0.1 * error(Nominal(plant))
    assert error(fit_residual(plant, adaptation)[0]) < error(Nominal(plant))


def leaned_on(plant, episodes, from_s, to_s):
    """Strides of a tenth of a second in which the elbow is pushed for a while, and the shoulder
    jerks now to one side, now to the other."""
    rng, count = np.random.default_rng(0), 40
    t = (np.arange(count) + 0.5) * 0.1
    residual = np.concatenate([rng.normal(size=(count, 2)) for _ in episodes])
    residual[:count, 1] -= 20.0 * ((t > from_s) & (t < to_s))
    residual[:count, 0] += 20.0 * np.where(np.arange(count) % 8 < 4, 1.0, -1.0) * (t > 2.0)
    many, one = np.ones_like(residual), np.ones(len(residual))
    at = np.concatenate([t / e.t_s[-1] for e in episodes])
    which = np.repeat(np.arange(len(episodes)), count)
    missed = np.tile(many, 2)
    return Strides(
        missed, residual, residual, many, many, many, many, at, many, many > 0.0, which, 0.1 * one
    )


def test_something_that_leans_on_a_joint_is_told_with_its_time(plant):
    episodes = recorded(plant, lambda _spec: None, (0, 1), ("adaptation", "validation"))
    (push,) = _pushed(plant, leaned_on(plant, episodes, 1.0, 2.2), episodes)
    assert push["episode"] == episodes[0].digest
    assert [j["joint"] for j in push["joints"]] == ["elbow"]
    assert push["from_s"] == pytest.approx(1.0)
    assert push["to_s"] == pytest.approx(2.2)
    assert push["joints"][0]["force"] < -15.0
    assert _pushed(plant, leaned_on(plant, episodes, 1.0, 1.5), episodes) == []
    roles = [{"sha256": e.digest, "role": str(e.role)} for e in episodes]
    gap = {"parameters_only": 0.1, "before": 0.1, "floor": 0.1}
    (words,) = warnings({"where": {"pushed": [push]}, "evidence": {"episodes": roles}, "gap": gap})
    assert "1 to 2.2 s: elbow by -2" in words


LATE = 15  # samples


def late_elbow(episode):
    """The same recording with the elbow seen later than the shoulder."""
    seen = episode.observations[LATE:].copy()
    seen[:, [1, 3]] = episode.observations[:-LATE, [1, 3]]
    t = episode.t_s[LATE:] - episode.t_s[LATE]
    return replace(
        episode,
        t_s=t,
        commands=episode.commands[LATE:].copy(),
        observations=seen,
        digest=f"{episode.digest}, late",
    )


@pytest.fixture(scope="module")
def late(plant):
    def sticks(spec):
        spec.joint("shoulder").frictionloss = 0.6

    episodes = [late_elbow(e) for e in recorded(plant, sticks, range(3), ROLES, 1.5)]
    return episodes, diagnose(plant, episodes)


def test_the_corrected_model_is_an_artifact_that_predicts_the_same(late):
    episodes, found = late
    again = unpack(pack(found.predictor, {"origin": "diagnosis"}))
    windows = cut(found.plant, episodes[-1], starts_every(episodes[-1].t_s, 0.5))
    np.testing.assert_array_equal(
        predict_observations(again, windows), predict_observations(found.predictor, windows)
    )


def test_a_late_sensor_at_one_joint_is_found_beside_friction_at_another(late):
    _, found = late
    assert {(e["effect"], e["joint"]) for e in found.document["effects"]} == {
        ("coulomb_friction", "shoulder"),
        ("sensor_delay", "elbow"),
    }
    delay = next(e for e in found.document["effects"] if e["effect"] == "sensor_delay")["estimate"][
        "delay"
    ]["value"]
    assert delay == pytest.approx(LATE * PERIOD_S, rel=0.02)
    # what the drive was told before the log is in no log
    assert found.document["gap"]["beginnings"] == "left out"
    assert "left out" in report_page(found.document, figures(found))


def test_what_a_late_sensor_shows_counts_for_the_window_in_which_it_happened(plant):
    (episode,) = recorded(plant, lambda _spec: None, (0,), ("adaptation",))
    s = series(plant, episode, DECLARED, 0.5)
    late = LATE * PERIOD_S + 1e-9
    windows, weight = seen_by(s, np.array([0.0, late]))
    np.testing.assert_array_equal(windows[:, 0], s.window_of)
    np.testing.assert_array_equal(windows[LATE + 1 :, 1], s.window_of[: -LATE - 1])
    assert (windows[:LATE, 1] == -1).all()  # before the log
    counted = windows >= 0
    np.testing.assert_allclose((weight**2 * counted).sum(axis=0), len(s.t_s))


def test_the_pitch_of_a_force_is_found_at_its_joint(plant):
    machine = arm_machine()
    toothed = machine.having("cogging", {"amplitude": 0.4, "pitch": 0.17, "phase": 1.0}, 1)
    t = np.arange(1500) * PERIOD_S
    q = np.stack([0.5 * np.sin(4.0 * t), 0.6 * np.cos(5.0 * t)], axis=1)
    plan = RobotPlan(
        "adaptation",
        np.zeros((1500, 2)),
        np.concatenate([q, np.gradient(q, PERIOD_S, axis=0)], axis=1),
    )
    found = run(
        toothed,
        plan,
        PERIOD_S,
        16,
        np.full(4, 1e-4),
        np.random.default_rng(0),
        50,
        Follow(np.array([60.0, 20.0]), np.array([6.0, 2.0])),
    )
    (like,) = recorded(plant, lambda _spec: None, (0,), ("adaptation",))
    episode = replace(like, t_s=found.t_s, commands=found.issued, observations=found.observed)
    admission = assess(plant, [episode])
    ((_, (_, _, pitch)), *_), taken = spatial_periods(plant, admission, 1, [episode])
    assert taken > 0.3
    assert pitch * admission.scales[1].position == pytest.approx(0.17, rel=0.03)
    assert spatial_periods(plant, admission, 0, [episode])[1] < 0.3


def test_a_joint_behind_a_spring_is_stepped_with_second_order(plant):
    machine = arm_machine()
    share, size = rotor(machine.tree, 1), plant.form.sizes[1]
    part = share / size
    period, ratio, both = 0.15, 0.08, part * (1.0 - part)
    stiffness, damping = (
        both * size * (2.0 * np.pi / period) ** 2,
        4.0 * np.pi / period * ratio * both * size,
    )
    soft = machine.having(
        "elastic_transmission", {"stiffness": stiffness, "damping": damping, "share": share}, 1
    )
    t = np.arange(250) * PERIOD_S
    u = np.stack([2.0 * np.sin(4.0 * t), 1.5 * np.cos(7.0 * t)], axis=1)
    plan = RobotPlan("adaptation", u, np.zeros((250, 4)))
    found = run(soft, plan, PERIOD_S, 64, np.zeros(4), np.random.default_rng(0))
    (like,) = recorded(plant, lambda _spec: None, (0,), ("adaptation",))
    episode = replace(like, t_s=found.t_s, commands=found.issued, observations=found.observed)
    fitter = Fitter(
        plant.form, directions(plant, [episode]), assess(plant, [episode]).scales, np.ones(4)
    )
    values, rows = (
        fitter.initial_values(plant.parameters),
        fitter.block.rows_of("elastic_transmission@1"),
    )
    rigid = np.repeat(values[:, None], BLOCK, axis=1)
    values[[rows["period"], rows["ratio"], rows["share"]]] = period, ratio, part
    p, on = (
        np.repeat(values[:, None], BLOCK, axis=1),
        switches(Hypothesis() | "elastic_transmission@1", 2),
    )

    def off(p, on, parts):
        s = series(plant, episode, Scheme(0.5, parts), 1.0)
        return np.abs(
            roll(s, plant.form, p, on, np.zeros((len(s.begin), 4, BLOCK)))[:, :, 0] - found.observed
        ).max()

    coarse, fine = (off(p, on, parts) for parts in (1, 2))
    assert coarse < 0.02 * off(rigid, switches(Hypothesis(), 2), 1)
    assert fine < 0.35 * coarse


def test_thinned_samples_are_rolled_out_in_merged_steps_that_differ_by_little(plant, monkeypatch):
    """Where three samples become one, so do steps, no longer than the symmetric scheme allows."""
    episodes = recorded(plant, rubs, range(2), ("adaptation", "validation"))
    recordings = Recordings.of(plant, episodes)
    setup = Setup(recordings, assess(plant, recordings.adaptation), refined(plant))
    monkeypatch.setattr(problem_setup, "thinning", lambda *_: 3)
    assert setup.thinned_by == 3
    assert setup.merged == min(3, mergeable(plant))
    assert Setup(recordings, setup.quality, DECLARED).merged == 1
    refitted = setup.refitted(1)
    problem, base = refitted.problem, refitted.base
    (s,) = problem.adaptation
    (apart,) = (series(plant, e, setup.scheme, problem.fits.length_s) for e in setup.episodes[0])
    assert s.steps.sum() * setup.merged == pytest.approx(apart.steps.sum(), rel=0.05)
    together, single = (trajectory(problem.fitter, base.fit, x) for x in (s, apart))
    motion = np.std(single, axis=0)
    assert (np.abs(together - single).max(axis=0) < 0.01 * motion).all()


@pytest.mark.parametrize(("times", "astray"), [(3.0, False), (5.0, True)])
def test_a_robot_is_searched_in_shorter_windows_where_a_fit_ends_far_behind_none(
    plant, times, astray
):
    (episode,) = recorded(plant, rubs, (0,), ("adaptation",))
    other = replace(episode, role=Role.VALIDATION, digest="other")
    recordings = Recordings.of(plant, [episode, other])
    refitted = Setup(recordings, assess(plant, [episode]), DECLARED).refitted(1)
    problem, base = refitted.problem, refitted.base
    search = Search(problem, candidates={base.hypothesis: base})
    far = replace(base.fit, hypothesis=Hypothesis() | "cogging", cost=times * base.fit.cost)
    search.candidates[far.hypothesis] = Candidate(far, base.check)
    assert went_astray(search) is astray
    joint = replace(problem.strategy, in_pieces=False)  # whose windows are short enough
    fits = replace(problem.fits, strategy=joint)
    assert not went_astray(replace(search, problem=replace(problem, fits=fits)))


@pytest.mark.parametrize("stage", ["SIL", "physical"])
def test_a_recording_that_is_neither_fitted_nor_compared_on_changes_no_criterion(plant, stage):
    used = [
        replace(e, conditions={"stage": stage})
        for e in recorded(plant, rubs, (0, 1), ("adaptation", "validation"), seconds=1.0)
    ]
    reference = replace(
        used[0], role=Role.REFERENCE, conditions={"stage": "physical"}, digest="reference"
    )
    criteria = Recordings.of(plant, [*used, reference]).criteria
    assert criteria.of_machine is (stage == "physical")
