"""Closed loop: paired runs of two models on one machine, and a gate that can ask for no regression
in tracking."""

import json
from dataclasses import replace

import numpy as np
import pytest

from tests.support.made import TRUE, corrected, episode_bytes, plant_document
from tests.support.robots import arm_plant
from trueup.bootstrap import LEAST
from trueup.control import closed_loop
from trueup.control.closed_loop import CANNOT, SEEDS, Tracking
from trueup.control.courses import TICKS, TURNS, Courses, Travelled
from trueup.control.estimator import transport_delay_s
from trueup.control.machine import machine_of, stand_in
from trueup.control.planner import Linearised
from trueup.episode.episode import Episode
from trueup.episode.mcap import read_episode
from trueup.episode.role import Role
from trueup.errors import NotIdentifiable
from trueup.fit.score import Score, Scoring
from trueup.gate.decision import Gate
from trueup.gate.judge import judge, run_trial
from trueup.gate.rule import Trial, rules
from trueup.model.block import term
from trueup.model.plant import Plant
from trueup.model.predictor import Identified, Nominal

pytestmark = pytest.mark.slow  # whole diagnoses, designs or installations

PLANT = Plant.from_document(plant_document())


def true(plant=PLANT, **effects):
    return corrected(plant, effects, TRUE)


MACHINE = true()


def compare(model, candidate, incumbent, travelled):
    """Both models in closed loop on the machine that a model describes."""
    courses = Courses.within(model.plant, travelled)
    return closed_loop.compare(machine_of(model), candidate, incumbent, courses)


@pytest.fixture
def one_run_each(monkeypatch):
    """Of each reference with each model, for half its time."""
    monkeypatch.setattr("trueup.control.closed_loop.SEEDS", 1)
    monkeypatch.setattr("trueup.control.courses.TICKS", 100)


def went(far):
    """A joint that was recorded so far to either side."""
    return Travelled(np.array([-far]), np.array([far]), np.array([1.0]), np.ones(1, bool))


def test_the_same_model_twice_tracks_the_same_to_the_last_digit():
    tracking = compare(MACHINE, MACHINE, true(), went(0.5))
    assert np.array_equal(tracking.candidate, tracking.incumbent)
    assert len(tracking.candidate) == SEEDS * len(TURNS)
    document = tracking.document()
    assert (document["change"], document["change_ci95"], document["stage"]) == (
        0.0,
        [0.0, 0.0],
        "MIL",
    )
    assert document["cannot_show"] == CANNOT


def test_a_model_that_is_wrong_about_its_drive_tracks_worse():
    weak = Identified(PLANT, (1.25, 0.62, -0.82))  # it believes that the drive pulls the other way
    tracking = compare(MACHINE, weak, MACHINE, went(0.5))
    assert tracking.candidate.mean() > 2.0 * tracking.incumbent.mean()
    assert tracking.document()["change_ci95"][0] > 0.0


def test_the_envelope_says_how_far_the_reference_goes_and_breaches_are_counted(one_run_each):
    assert compare(MACHINE, MACHINE, MACHINE, went(99.0)).amplitude == (pytest.approx(0.6 * 0.9),)
    tight = Plant.from_document(
        {**plant_document(), "envelope": {"q": [-0.9, 0.9], "v": [-0.01, 0.01]}}
    )
    machine = true(tight)
    assert compare(machine, machine, machine, went(0.5)).breaches[0] > 0.5


def test_what_the_machine_remembers_is_remembered_from_tick_to_tick(one_run_each):
    lazy = true(actuator_lag={"time_constant": 0.4})
    alone, behind = (
        compare(MACHINE, MACHINE, MACHINE, went(0.5)),
        compare(lazy, MACHINE, MACHINE, went(0.5)),
    )
    assert behind.candidate.mean() > 1.2 * alone.candidate.mean()


def test_a_gate_can_refuse_a_better_prediction_that_tracks_worse():
    gate = Gate((rules()["rollout_improves"](), rules()["tracking_no_worse"]()), Scoring(2.0))
    episode = read_episode(episode_bytes(3, role=Role.VALIDATION), PLANT.layout)
    seen: list[float] = []
    result = run_trial(gate, MACHINE, Nominal(PLANT), [episode], seen.append).trial
    assert seen == sorted(seen)
    assert seen[-1] == pytest.approx(1.0)
    worse = replace(
        result,
        tracking=Tracking(
            result.tracking.incumbent * 1.2, result.tracking.incumbent, (0.0, 0.0), (0.5,)
        ),
    )
    breaching = replace(
        result,
        tracking=replace(result.tracking, candidate=result.tracking.incumbent, breaches=(0.1, 0.0)),
    )
    for trial, passed in (
        (result, True),
        (worse, False),
        (breaching, False),
        (replace(result, tracking=None), False),
    ):
        verdicts = {
            v.rule: v
            for v in judge(
                gate, trial, plant="p", candidate="c", incumbent="i", generation=1
            ).verdicts
        }
        assert verdicts["rollout_improves"].passed
        assert verdicts["tracking_no_worse"].passed is passed
    document = judge(gate, result, plant="p", candidate="c", incumbent="i", generation=1).document()
    assert document["figures"]["closed_loop"]["runs"] == len(result.tracking.candidate)


def test_without_a_diagnosis_the_decision_says_which_plant_stands_in(one_run_each):
    gate = Gate((rules()["rollout_improves"](), rules()["tracking_no_worse"]()), Scoring(2.0))
    episode = read_episode(episode_bytes(3, role=Role.VALIDATION), PLANT.layout)
    identified, nominal = Identified(PLANT, TRUE), Nominal(PLANT)
    trial = run_trial(gate, identified, nominal, [episode]).trial
    assert "identified parameters, since nobody has diagnosed" in trial.tracking.document()["shows"]
    on_the_identified = compare(identified, identified, nominal, Travelled.of(PLANT, [episode]))
    assert np.array_equal(trial.tracking.candidate, on_the_identified.candidate)
    assert np.array_equal(trial.tracking.incumbent, on_the_identified.incumbent)


def test_a_diagnosis_stands_in_before_parameters_and_these_before_the_nominal_plant():
    models = {"nominal": Nominal(PLANT), "fit": Identified(PLANT, TRUE), "diagnosis": MACHINE}
    assert stand_in(models)[0] == "diagnosis"
    assert stand_in({name: models[name] for name in ("nominal", "fit")})[0] == "fit"
    assert stand_in({"second": true(), "diagnosis": MACHINE})[0] == "second"
    with pytest.raises(ValueError, match="no model"):
        stand_in({})


@pytest.fixture
def arm(tmp_path, one_run_each):
    return arm_plant(tmp_path)


def of_arm(plant, *effects):
    return corrected(plant, {term(name, at): {number: x} for name, at, number, x in effects})


REACHED = Travelled(
    np.array([-0.6, -0.5]), np.array([0.6, 0.7]), np.array([2.0, 2.5]), np.ones(2, bool)
)


def test_an_arm_tracks_better_with_the_model_that_knows_its_friction(arm, monkeypatch):
    monkeypatch.setattr("trueup.control.courses.TICKS", TICKS)  # its beginning weighs less
    machine = of_arm(arm, ("coulomb_friction", 1, "level", 3.0))
    tracking = compare(machine, machine, Nominal(arm), REACHED)
    assert tracking.candidate.mean() < 0.5 * tracking.incumbent.mean()
    assert tracking.candidate.max() < 0.002  # of the amplitude's square
    assert (tracking.candidate < tracking.incumbent).all()
    document = tracking.document()
    assert len(tracking.candidate) < LEAST
    assert document["change_ci95"] is None  # of so few runs
    assert document["amplitude"] == pytest.approx([0.36, 0.36])


def test_an_arms_references_are_no_faster_and_no_further_than_it_was_recorded(arm):
    courses = Courses.within(arm, replace(REACHED, speed=np.array([0.2, 2.5])))
    fastest = [
        np.abs(np.gradient(courses.reference(hz), courses.tick_s, axis=0)).max(axis=0)
        for hz in courses.frequencies_hz
    ]
    assert np.max(fastest, axis=0)[0] == pytest.approx(0.2, rel=0.01)
    tight = Plant.from_document({**arm.document, "envelope": {"q_elbow": [0.0, 0.2]}})
    assert Courses.within(tight, REACHED).amplitude == pytest.approx((0.36, 0.06))


def test_a_joint_that_never_moved_is_held_still_and_counts_for_nothing(arm):
    machine = of_arm(arm)
    still = replace(
        REACHED, low=np.array([-0.6, 0.1]), high=np.array([0.6, 0.1]), moved=np.array([True, False])
    )
    tracking = compare(machine, machine, machine, still)
    assert tracking.amplitude == pytest.approx((0.36, 0.0))
    assert tracking.candidate.max() < 0.005
    with pytest.raises(NotIdentifiable, match="no joint"):
        compare(machine, machine, machine, replace(REACHED, moved=np.zeros(2, bool)))


def test_what_moved_is_told_from_what_noise_moves(arm):
    rng, t_s = np.random.default_rng(0), np.arange(500) * arm.timestep_s
    q = np.stack([0.5 * np.sin(3.0 * t_s), 0.1 + 4e-4 * rng.standard_normal(500)], axis=1)
    v = np.stack([1.5 * np.cos(3.0 * t_s), np.zeros(500)], axis=1)
    v[77, 0] = 40.0  # one glitch
    went = Travelled.of(
        arm,
        [
            Episode(
                t_s, np.zeros((500, 2)), np.hstack([q, v]), arm.layout, Role.VALIDATION, {}, 0, "d"
            )
        ],
    )
    assert went.moved.tolist() == [True, False]
    assert went.speed[0] == pytest.approx(1.5, rel=0.01)


@pytest.mark.parametrize(
    ("state", "reference"),
    [
        ([0.0, 0.0, 0.0, 0.0], [-0.6, 0.3]),
        ([-0.2, 0.35, -0.2, -0.05], [-0.79, 0.19]),
        ([0.0, 0.0, 0.0, 0.0], [0.1, 0.0]),
    ],
)
def test_the_plan_is_as_good_as_the_best_of_a_grid_between_the_limits(arm, state, reference):
    planner = Linearised(Nominal(arm), (0.1, 0.1), hold=3)
    wanted = np.repeat(np.array([reference]), 8, axis=0)

    def cost(commands):
        off = planner._off(np.array(state), commands, wanted / planner.scale)
        return (off**2).sum(axis=1) + planner.effort * ((commands / 50.0) ** 2).sum(axis=1)

    grid = np.stack(
        np.meshgrid(np.linspace(-25, 25, 41), np.linspace(-25, 25, 41)), axis=-1
    ).reshape(-1, 2)
    command = planner.plan(np.array(state), wanted, np.random.default_rng(0))
    assert cost(command[None, :])[0] <= 1.02 * cost(grid).min() + 1e-3


def test_a_delay_that_all_joints_share_is_planned_over(arm):
    both = of_arm(arm, *(("actuator_delay", j, "delay", 0.06) for j in range(2)))
    assert transport_delay_s(both) == pytest.approx(0.06)
    assert transport_delay_s(of_arm(arm, ("actuator_delay", 0, "delay", 0.06))) == 0.0
    tracking = compare(both, both, Nominal(arm), REACHED)
    assert tracking.candidate.mean() < 0.5 * tracking.incumbent.mean()


def test_a_course_is_the_steps_one_by_one(arm):
    states, commands = (
        np.array([[0.1, -0.2, 0.3, 0.0], [0.0, 0.0, 0.0, 0.1]]),
        np.array([[1.0, 0.5], [-2.0, 0.0]]),
    )
    for predictor in (Nominal(arm), of_arm(arm, ("quadratic_drag", 0, "coefficient", 0.2))):
        one = predictor.predict_batch(states, commands)
        two = predictor.predict_batch(one, commands)
        assert predictor.hold(states, commands, 2) == pytest.approx(
            np.stack([one, two], axis=1), abs=1e-9
        )


def test_a_joint_that_nobody_commands_is_refused(arm):
    passive = Plant.from_document({**arm.document, "commands": arm.document["commands"][:1]})
    with pytest.raises(NotIdentifiable, match="without a command"):
        compare(of_arm(passive), of_arm(passive), of_arm(passive), REACHED)


def test_runs_that_run_away_can_be_written_down_and_never_pass():
    tracking = Tracking(np.array([np.inf, 1.0]), np.ones(2), (0.0, 0.0), (1.0,))
    document = tracking.document()
    assert (document["candidate"], document["change_ci95"]) == (None, None)
    json.dumps(document, allow_nan=False)
    one = Score(np.ones(1), np.ones(1))
    verdict = rules()["tracking_no_worse"]()(Trial(one, one, ("e",), ((),), (), tracking))
    assert not verdict.passed
