"""The doctor on logs that were spoilt on purpose, simulated and real, and on the same logs as they
were."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.support.robots import arm_plant
from tests.support.robots import recorded as recorded_arm
from tests.support.simulated import recorded
from tests.support.spoilt import ANGLES, EVERYWHERE, LENGTHS, TWO_JOINTS, WITH_VELOCITY
from trueup.diagnose.case import read_case
from trueup.doctor.examine import examine, usable
from trueup.doctor.finding import Fault
from trueup.doctor.log import Log
from trueup.doctor.mends import CutAtGaps

EXAMPLES = Path(__file__).parents[3] / "examples"
CLEARED = {  # by their mends, that which was recorded being as it should be afterwards
    Fault.COMMAND_SIGN,
    Fault.COMMAND_SCALE,
    Fault.POSITION_UNIT,
    Fault.LENGTH_UNIT,
    Fault.VELOCITY_UNIT,
    Fault.VELOCITY_SIGN,
    Fault.JOINTS_SWAPPED,
}


@pytest.fixture(scope="module")
def emps():
    return read_case(EXAMPLES / "emps")


@pytest.fixture(scope="module")
def pendulum():
    plant, episodes, _ = recorded("B1", ["coulomb_friction"], 7)
    return plant, episodes


@pytest.fixture(scope="module")
def inertia():
    plant, episodes, _ = recorded("B2", ["actuator_delay"], 5)
    return plant, episodes


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    plant = arm_plant(tmp_path_factory.mktemp("arm"))
    roles = ["adaptation", "adaptation", "validation"]
    return plant, recorded_arm(plant, lambda _: None, range(3), roles, seconds=5.0)


def names(plant, episodes):
    return [f.fault for f in examine(plant, episodes)]


@pytest.mark.parametrize("machine", ["emps", "pendulum", "inertia", "arm"])
def test_nothing_is_found_in_a_sound_log(machine, request):
    plant, episodes = request.getfixturevalue(machine)
    assert examine(plant, episodes) == []


@pytest.mark.parametrize("tier", ["A0", "A1", "B1", "B2"])
@pytest.mark.parametrize(
    "effect", ["sensor_delay", "dropped_frames", "hard_stop", "sensor_quantization", "saturation"]
)
def test_an_effect_of_the_machine_is_no_fault_of_the_log(tier, effect):
    plant, episodes, _ = recorded(tier, [effect], 3)
    assert examine(plant, episodes) == []


def test_nothing_is_found_in_a_sound_log_of_six_servos_that_mostly_rest():
    assert examine(*read_case(EXAMPLES / "so101")) == []


@pytest.mark.parametrize("what", [*EVERYWHERE, *LENGTHS])
def test_each_fault_of_a_real_log_is_named_for_what_it_is(emps, what):
    fault, spoil = {**EVERYWHERE, **LENGTHS}[what]
    plant, episodes = emps
    assert fault in names(plant, spoil(plant, episodes))


@pytest.mark.parametrize("machine", ["pendulum", "inertia"])
@pytest.mark.parametrize("what", [*EVERYWHERE, *ANGLES, *WITH_VELOCITY])
def test_each_fault_of_a_simulated_log_is_named_for_what_it_is(machine, what, request):
    fault, spoil = {**EVERYWHERE, **ANGLES, **WITH_VELOCITY}[what]
    plant, episodes = request.getfixturevalue(machine)
    spoilt = spoil(plant, episodes)
    findings = examine(plant, spoilt)
    assert fault in [f.fault for f in findings]
    if fault in CLEARED:
        mended = Log(plant, spoilt).mended([m for f in findings for m in f.mends])
        assert examine(plant, mended.episodes) == []


@pytest.mark.parametrize("what", [*EVERYWHERE, *ANGLES, *WITH_VELOCITY, *TWO_JOINTS])
def test_each_fault_of_an_arm_s_log_is_named_for_what_it_is(arm, what):
    fault, spoil = {**EVERYWHERE, **ANGLES, **WITH_VELOCITY, **TWO_JOINTS}[what]
    plant, episodes = arm
    assert fault in names(plant, spoil(plant, episodes))


def test_a_mend_restores_the_numbers(pendulum):
    plant, episodes = pendulum
    for what in ("degrees", "velocity in rpm", "command sign"):
        spoilt = {**EVERYWHERE, **ANGLES, **WITH_VELOCITY}[what][1](plant, episodes)
        findings = examine(plant, spoilt)
        mended = Log(plant, spoilt).mended([m for f in findings for m in f.mends])
        for was, became in zip(episodes, mended.episodes, strict=True):
            np.testing.assert_allclose(became.observations, was.observations, rtol=1e-9)
            np.testing.assert_allclose(became.commands, was.commands, rtol=1e-9)


def test_what_says_nothing_is_left_out_and_recordings_are_cut_at_gaps(pendulum):
    plant, episodes = pendulum
    spoilt = EVERYWHERE["a gap"][1](plant, episodes)
    known = usable(plant, spoilt)
    assert len(known.episodes) == 2 * len(episodes)
    assert not any(len(e.gaps) for e in known.episodes)
    assert {e.recording for e in known.episodes} == {e.digest for e in spoilt}
    assert all(f.applied for f in known.findings)
    second = known.episodes[1]
    whole = next(e for e in spoilt if e.digest == second.recording)
    at = np.searchsorted(whole.t_s, second.begins_s)
    np.testing.assert_array_equal(
        second.observations, whole.observations[at : at + len(second.t_s)]
    )


def test_a_stuck_encoder_s_samples_count_no_longer(pendulum):
    plant, episodes = pendulum
    spoilt = EVERYWHERE["a stuck encoder"][1](plant, episodes)
    before = sum(len(e.t_s) for e in spoilt)
    after = sum(len(e.t_s) for e in usable(plant, spoilt).episodes)
    assert 0.5 * before < after < before - 1.0 / plant.timestep_s


def test_a_sign_is_told_and_not_changed(pendulum):
    plant, episodes = pendulum
    spoilt = EVERYWHERE["command sign"][1](plant, episodes)
    known = usable(plant, spoilt)
    assert [f.applied for f in known.findings] == [False]
    assert all(a is b for a, b in zip(known.episodes, spoilt, strict=True))


def test_a_finding_says_where_it_is_and_how_it_is_mended(pendulum):
    plant, episodes = pendulum
    spoilt = [WITH_VELOCITY["velocity in rpm"][1](plant, episodes[:1])[0], *episodes[1:]]
    (finding,) = examine(plant, spoilt)
    document = finding.document()
    assert document["finding"] == "velocity_unit"
    assert document["channel"] == "v"
    assert document["episodes"] == [episodes[0].digest]
    assert "rpm" in document["mend"]
    assert 0.9 < document["confidence"] <= 1.0
    assert document["applied"] is False


@pytest.mark.parametrize("samples", [2, 5, 40])
def test_short_logs_have_no_findings(pendulum, samples):
    plant, episodes = pendulum
    short = [
        replace(
            e,
            t_s=e.t_s[:samples].copy(),
            commands=e.commands[:samples].copy(),
            observations=e.observations[:samples].copy(),
        )
        for e in episodes
    ]
    assert examine(plant, short) == []
    assert examine(plant, []) == []


@pytest.mark.parametrize("what", ["positions", "velocities", "commands", "everything"])
def test_what_never_changes_is_looked_at_without_harm(pendulum, what):
    plant, episodes = pendulum
    still = []
    for e in episodes:
        seen, issued = e.observations.copy(), e.commands.copy()
        if what in ("positions", "everything"):
            seen[:, 0] = 1.0
        if what in ("velocities", "everything"):
            seen[:, 1] = 0.0
        if what in ("commands", "everything"):
            issued[:] = 0.0
        still.append(replace(e, observations=seen, commands=issued))
    assert usable(plant, still).findings == ()


def test_stamps_that_come_at_random_are_no_gaps(pendulum):
    plant, episodes = pendulum
    rng = np.random.default_rng(0)
    spans = [rng.exponential(e.period_s, len(e.t_s) - 1) for e in episodes]
    irregular = [
        replace(e, t_s=np.append(0.0, np.cumsum(x))) for e, x in zip(episodes, spans, strict=True)
    ]
    assert all(len(e.gaps) for e in irregular)
    assert Fault.GAP not in names(plant, irregular)


def test_pieces_shorter_than_a_prediction_are_left_out_but_for_the_longest(pendulum):
    plant, episodes = pendulum
    spoilt = EVERYWHERE["a gap"][1](plant, episodes)[0]
    lengths = [
        [round(float(p.t_s[-1]), 1) for p in CutAtGaps((spoilt.digest,), least).apply(spoilt)]
        for least in (0.0, 1e9)
    ]
    assert len(lengths[0]) == 2
    assert lengths[1] == [max(lengths[0])]
