"""What a diagnosis says of machines whose faults are known, made by the second simulator."""

from dataclasses import replace

import numpy as np
import pytest

from tests.support.simulated import recorded as recorded_thrice
from tests.support.simulated import recorded_twice as recorded
from trueup.diagnose.data_quality import assess
from trueup.diagnose.diagnosis import diagnose
from trueup.diagnose.figures import figures
from trueup.diagnose.number_text import percent
from trueup.diagnose.problem_setup import Recordings, Setup
from trueup.diagnose.search import Search
from trueup.diagnose.summary_text import sentence, waterfall
from trueup.episode.role import Role
from trueup.errors import NotIdentifiable
from trueup.fit.fitter import Fitter
from trueup.fit.free_numbers import Directions
from trueup.fit.rollout_fit import PROVEN
from trueup.fit.screening import screen
from trueup.model.hypothesis import Hypothesis
from trueup.model.series import DECLARED, refined, series
from trueup.model.velocity_prior import VelocityPrior, velocity_prior
from trueup.randomise.randomisation import Randomisation
from trueup.randomise.supported import supported_ranges
from trueup_pages.diagnosis import report_page

pytestmark = pytest.mark.slow  # whole diagnoses, designs or installations


def named(found):
    return [e["effect"] for e in found.document["effects"]]


def truth_in(entry, parameter, value):
    low, high = entry["estimate"][parameter]["ci95"]
    return low <= value <= high


def near(entry, parameter, value):
    """Whether an estimate is within 1 % of the truth. Dry friction at a coarse step is biased by
    about that, which is more than its interval."""
    return abs(entry["estimate"][parameter]["value"] - value) <= 0.01 * abs(value)


@pytest.fixture(scope="module")
def friction():
    plant, episodes, trial = recorded("A1", ["coulomb_friction"], 11)
    return plant, episodes, trial, diagnose(plant, episodes)


def test_friction_is_named_with_its_level_and_the_gap_closes(friction):
    _, _, trial, found = friction
    assert (found.document["verdict"], named(found)) == ("effect", ["coulomb_friction"])
    assert found.document["indistinguishable"] == []
    assert near(
        found.document["effects"][0],
        "level",
        trial.machine.imperfections["coulomb_friction"]["level"],
    )
    gap = found.document["gap"]
    assert gap["closed"] > 0.98
    assert gap["floor"] <= gap["after"] * 1.1 < gap["parameters_only"] < gap["before"] * 1.05


def test_parameters_are_found_beside_the_effect(friction):
    _, _, trial, found = friction
    for name, true in (("k", trial.machine.k), ("c", trial.machine.c), ("b", trial.machine.b)):
        assert found.document["parameters"][name]["value"] == pytest.approx(true, rel=0.02)


def test_numbers_that_motion_shows_together_are_said_to_be_off_together(friction):
    plant, _, _, found = friction
    pairs = {(a, b): r for a, b, r in found.document["evidence"]["correlations"]}
    assert all(-1.0 <= r <= 1.0 for r in pairs.values())
    assert {name for pair in pairs for name in pair} <= {
        *plant.nominal,
        "coulomb_friction.level",
    }
    # above its resonance the joint goes against its command, and a spring pulls with it
    assert pairs["k", "b"] < -0.4
    family = Randomisation.of(plant, supported_ranges(found.predictor, found.document))
    alone = replace(family, kinds=tuple(replace(k, correlation=None) for k in family.kinds))
    together = []
    for of in (family, alone):
        rng = np.random.default_rng(0)
        drawn = [of.draw(rng) for _ in range(300)]
        together.append(
            np.std([d["b"] / plant.nominal["b"] + d["k"] / plant.nominal["k"] for d in drawn])
        )
    assert together[0] < 0.85 * together[1]


def test_what_is_absent_is_bounded(friction):
    _, _, _, found = friction
    delay = next(b for b in found.document["excluded"] if b["effect"] == "actuator_delay")
    assert 0.0 < delay["below"] < 0.01
    assert {b["effect"] for b in found.document["excluded"]}.isdisjoint(named(found))


def test_the_same_episodes_give_the_same_report(friction):
    plant, episodes, _, found = friction
    assert diagnose(plant, episodes).document == found.document


def test_the_page_says_what_the_report_says(friction):
    _, _, _, found = friction
    text = report_page(found.document, figures(found))
    assert "Coulomb friction" in sentence(found.document)
    assert "<svg" in text
    assert "http" not in text
    assert sentence(found.document).replace("&", "&amp;") in text


def test_validation_episodes_are_never_fitted(friction):
    plant, episodes, _, found = friction
    cut = [e if e.role is Role.ADAPTATION else episodes[-1] for e in episodes[:-1]]
    again = diagnose(plant, cut)
    assert again.document["parameters"]["k"]["value"] == pytest.approx(
        found.document["parameters"]["k"]["value"], rel=1e-6
    )


def test_new_numbers_in_the_nominal_form_are_parameters_only():
    plant, episodes, _ = recorded("A1", [], 5)
    found = diagnose(plant, episodes)
    assert (found.document["verdict"], named(found)) == ("parameters_only", [])
    assert found.document["gap"]["closed"] > 0.98


def test_nominal_numbers_that_hold_are_told_from_the_steps_they_are_integrated_on():
    plant, episodes, _ = recorded("B1", [], 6, shifted=False)
    found = diagnose(plant, episodes)
    assert (found.document["verdict"], named(found)) == ("no_gap", [])
    assert found.document["gap"]["closed"] > 0.9
    integration, numbers, *_, noise = waterfall(found.document)
    assert (integration["what"], numbers["what"]) == (
        "integration and start",
        "refitted parameters",
    )
    part = integration["share"] / (1.0 - noise["share"])
    assert part > 0.95
    assert numbers["share"] < 0.01
    assert sentence(found.document).startswith(
        "No effect is missing and no parameter has to change. The integration scheme and the "
        f"filtered start of this diagnosis close {percent(part)} of the gap. The held-out error "
    )


def test_a_delay_of_the_sensor_has_the_law_of_the_actuators():
    plant, episodes, _ = recorded("A1", ["sensor_delay"], 8)
    found = diagnose(plant, episodes)
    assert named(found) == ["actuator_delay"]
    assert ["sensor_delay"] in found.document["indistinguishable"]
    assert "clock" in found.document["next_experiment"]["why"]
    assert found.document["next_experiment"]["command"] is None


def test_a_bias_and_a_constant_force_are_one_on_a_linear_spring():
    plant, episodes, _ = recorded_thrice("A1", ["sensor_bias"], 9)
    found = diagnose(plant, episodes)
    named_or_rival = {
        *named(found),
        *(e for other in found.document["indistinguishable"] for e in other),
    }
    assert named_or_rival == {"sensor_bias", "constant_force"}


def test_two_effects_are_named_together():
    plant, episodes, _ = recorded("B1", ["gain_asymmetry", "coulomb_friction"], 12)
    found = diagnose(plant, episodes)
    assert sorted(named(found)) == ["coulomb_friction", "gain_asymmetry"]
    assert all(e["share"] > 0.0 for e in found.document["effects"])


@pytest.fixture(scope="module")
def unexplained():
    plant, episodes, _ = recorded("A1", ["k_modulated"], 13)
    return plant, episodes, diagnose(plant, episodes)


def test_an_effect_outside_the_catalogue_is_not_named(unexplained):
    _, _, found = unexplained
    assert (found.document["verdict"], named(found)) == ("unknown_effect", [])


def test_positions_alone_are_enough():
    plant, episodes, _ = recorded("A1", ["deadband"], 14, velocity=False)
    found = diagnose(plant, episodes)
    assert named(found) == ["deadband"]


def test_held_frames_are_counted():
    plant, episodes, trial = recorded("B2", ["dropped_frames"], 15)
    found = diagnose(plant, episodes)
    assert named(found) == ["dropped_frames"]
    fraction = found.document["effects"][0]["estimate"]["fraction"]["value"]
    assert fraction == pytest.approx(
        trial.machine.imperfections["dropped_frames"]["fraction"], abs=0.02
    )


def test_a_coarse_sensor_is_told_by_its_lattice():
    plant, episodes, trial = recorded("A1", ["sensor_quantization"], 16)
    found = diagnose(plant, episodes)
    assert "sensor_quantization" in named(found)
    step = next(e for e in found.document["effects"] if e["effect"] == "sensor_quantization")[
        "estimate"
    ]["step"]["value"]
    assert step == pytest.approx(
        trial.machine.imperfections["sensor_quantization"]["step"], rel=1e-3
    )


def test_a_discrete_plant_is_fitted_by_its_own_step():
    plant, episodes, trial = recorded("A0", ["quadratic_drag"], 17)
    found = diagnose(plant, episodes)
    assert named(found) == ["quadratic_drag"]
    value = found.document["effects"][0]["estimate"]["coefficient"]["value"]
    assert value == pytest.approx(
        trial.machine.imperfections["quadratic_drag"]["coefficient"], rel=1e-4
    )


def test_without_validation_it_says_what_to_do():
    plant, episodes, _ = recorded("A1", [], 5)
    with pytest.raises(NotIdentifiable) as raised:
        diagnose(plant, [e for e in episodes if e.role is Role.ADAPTATION])
    assert "validation" in raised.value.hint


def test_a_joint_that_never_moves_is_no_case():
    plant, episodes, _ = recorded("A1", [], 5)
    still = [
        type(e)(
            e.t_s,
            0.0 * e.commands,
            0.0 * e.observations,
            e.layout,
            e.role,
            e.conditions,
            0,
            e.digest,
        )
        for e in episodes
    ]
    with pytest.raises(NotIdentifiable, match="never moves"):
        diagnose(plant, still)


def test_progress_is_told_from_the_start():
    plant, episodes, _ = recorded("A1", [], 5)
    told = []
    diagnose(plant, episodes, progress=lambda stage, part: told.append((stage, part)))
    assert told[0][0] == "looking for faults in the log"
    assert told[-1] == ("done", 1.0)
    assert all(0.0 <= part <= 1.0 for _, part in told)


def test_the_noise_is_told_from_the_signal():
    plant, episodes, trial = recorded("B1", ["coulomb_friction"], 18)
    found = diagnose(plant, episodes)
    assert np.allclose(
        [found.document["evidence"]["noise"][n] for n in ("q", "v")], trial.sigma, rtol=0.1
    )


def test_a_composition_that_fills_every_lane_has_no_bounds_beside_it():
    plant, episodes, _ = recorded("A1", ["coulomb_friction"], 3)
    admission = assess(plant, [e for e in episodes if e.role == "adaptation"])
    fitter = Fitter(
        plant.form,
        Directions.of_family(plant.dynamics.parameter_names),
        admission.scales,
        admission.sigma,
    )
    full = Hypothesis(("stribeck_friction", "hysteresis", "hard_stop"))
    assert not fitter.has_room(full)
    data = [series(plant, episodes[0], refined(plant), 2.0)]
    parent = fitter.fit(data, Hypothesis(), fitter.initial_values(plant.parameters), iterations=1)
    screened = screen(fitter, data, replace(parent, hypothesis=full), "cogging")
    assert np.isinf(screened.error).all()
    assert (screened.cost == parent.cost).all()


def test_a_velocity_that_is_logged_late_is_told_and_costs_no_friction():
    plant, episodes, trial = recorded("B1", ["velocity_lag", "coulomb_friction"], 24)
    found = diagnose(plant, episodes)
    assert sorted(named(found)) == ["coulomb_friction", "velocity_lag"]
    truth = trial.machine.imperfections
    late, dry = (
        next(e for e in found.document["effects"] if e["effect"] == name)
        for name in ("velocity_lag", "coulomb_friction")
    )
    assert truth_in(late, "time_constant", truth["velocity_lag"]["time_constant"])
    assert near(dry, "level", truth["coulomb_friction"]["level"])


def test_a_fall_of_the_drive_with_its_size_has_a_sign():
    plant, episodes, trial = recorded("A1", ["quadratic_gain"], 25)
    found = diagnose(plant, episodes)
    assert named(found) == ["quadratic_gain"]
    truth = trial.machine.imperfections["quadratic_gain"]
    assert all(truth_in(found.document["effects"][0], name, truth[name]) for name in truth)


def test_a_play_that_began_anywhere_is_found():
    plant, episodes, trial = recorded("B2", ["backlash", "deadband"], 27)
    found = diagnose(plant, episodes)
    assert sorted(named(found)) == ["backlash", "deadband"]
    entries = {e["effect"]: e for e in found.document["effects"]}
    assert truth_in(entries["backlash"], "gap", trial.machine.imperfections["backlash"]["gap"])
    assert truth_in(entries["deadband"], "width", trial.machine.imperfections["deadband"]["width"])


def test_a_coarse_command_is_found_between_its_corners():
    plant, episodes, trial = recorded("A1", ["command_quantization"], 7003)
    found = diagnose(plant, episodes)
    assert named(found) == ["command_quantization"]
    assert truth_in(
        found.document["effects"][0],
        "step",
        trial.machine.imperfections["command_quantization"]["step"],
    )


@pytest.mark.parametrize("effect", ["constant_force", "gain_asymmetry"])
@pytest.mark.parametrize("seed", [31, 32, 33])
def test_either_sign_of_an_effect_is_named(effect, seed):
    plant, episodes, _ = recorded("B1", [effect], seed)
    assert named(diagnose(plant, episodes)) == [effect]


def test_a_lag_below_one_sample_is_no_effect():
    plant, episodes, _ = recorded("A0", [], 5)
    recordings = Recordings.of(plant, episodes)
    problem = Setup(recordings, assess(plant, episodes), DECLARED).refitted(1).problem
    search, fitter, data = Search(problem, candidates={}), problem.fitter, problem.adaptation
    values = fitter.initial_values(plant.parameters)
    for periods, resolved in ((0.5, False), (3.0, True)):
        values[plant.block.rows_of("velocity_lag")["time_constant"]] = (
            periods * episodes[0].period_s
        )
        fit = fitter.fit(data, Hypothesis(("velocity_lag",)), values, iterations=0)
        assert search.keep(fit).resolved is resolved
        assert any(c.hypothesis.effects for c in search) is resolved


def test_a_first_velocity_is_known_from_like_moments():
    t = np.linspace(0.0, 8.0 * np.pi, 4000)
    loop = np.column_stack([np.sin(t), np.cos(t) + 2.0 * np.cos(3.0 * t), np.cos(t)])
    moments, missed = velocity_prior([loop[:2000], loop[2000:]])
    assert moments.nearest > 0
    assert missed < 0.1
    assert moments.velocity(np.sin(1.0), np.cos(1.0) + 2.0 * np.cos(3.0)) == pytest.approx(
        np.cos(1.0), abs=0.02
    )
    rng = np.random.default_rng(1)
    cloud = rng.normal(size=(2000, 3))
    cloud[:, 2] += 0.5 * cloud[:, 0] - 0.2 * cloud[:, 1]
    line, missed = velocity_prior([cloud[:1000], cloud[1000:]])
    assert line.nearest == 0
    assert missed == pytest.approx(1.0, abs=0.1)
    assert line.velocity(2.0, 1.0) == pytest.approx(0.8, abs=0.1)


@pytest.mark.parametrize(
    "moments", [np.zeros((0, 3)), np.zeros((4, 2)), np.full((4, 3), np.nan), np.zeros(3)]
)
def test_moments_that_are_none_are_refused(moments):
    with pytest.raises(ValueError, match="position, command and velocity"):
        VelocityPrior(moments, 1)


def test_where_impacts_make_whole_windows_too_rough_for_a_proof_shorter_ones_prove_the_answer():
    plant, episodes, trial = recorded("B1", ["hard_stop"], 7)
    found = diagnose(plant, episodes)
    (effect,), (fit,) = found.document["effects"], found.document["evidence"]["convergence"]
    assert effect["effect"] == "hard_stop"
    assert fit["off"] <= PROVEN
    assert not found.choice.winner.fit.proven  # nothing on whole windows would have been
    low, high = effect["estimate"]["limit"]["ci95"]
    assert low < trial.machine.imperfections["hard_stop"]["limit"] < high


def test_a_log_that_declares_no_stage_is_judged_by_what_it_leaves(unexplained):
    """What no effect explains exactly is a machine's, unless the log says that it is not."""
    plant, episodes, found = unexplained
    exact = found.document
    assert (exact["verdict"], exact["evidence"]["judged_as"]) == ("unknown_effect", "simulator")
    undeclared = [replace(e, conditions={}) for e in episodes]
    assert diagnose(plant, undeclared).document["evidence"]["judged_as"] == "machine"
    plant, episodes, _ = recorded("A1", ["coulomb_friction"], 3)
    sound = [replace(e, conditions={}) for e in episodes]
    assert diagnose(plant, sound).document["evidence"]["judged_as"] == "simulator"
