"""What a log's clocks and loops say of its stamps."""

from dataclasses import replace

import pytest

from tests.support.robots import PERIOD_S, arm_plant
from tests.support.robots import recorded as recorded_arm
from tests.support.simulated import recorded
from tests.support.spoilt import as_recorded
from trueup.doctor.answers import loop
from trueup.doctor.examine import examine
from trueup.doctor.finding import Fault
from trueup.doctor.log import Log


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    plant = arm_plant(tmp_path_factory.mktemp("arm"))
    roles = ["adaptation", "adaptation", "validation"]
    return plant, recorded_arm(plant, lambda _: None, range(3), roles, seconds=5.0)


def test_the_gains_of_a_loop_are_told(arm):
    loops = [loop(Log(*arm), joint) for joint in range(2)]
    assert [closed.kind for closed in loops] == ["PD", "PD"]
    assert [closed.position for closed in loops] == pytest.approx([40.0, 15.0], rel=0.02)
    assert [closed.velocity for closed in loops] == pytest.approx([4.0, 1.5], rel=0.02)


def test_an_open_loop_is_told_as_one():
    plant, episodes, _ = recorded("B1", [], 7)
    assert loop(Log(plant, episodes), 0).kind == "open"


def test_a_command_that_answers_before_the_sensor_shows_tells_late_stamps(arm):
    """Observations that are shown some samples late at the same stamps: both topics begin and end
    together."""
    plant, episodes = arm
    late = 8
    spoilt = [
        replace(
            e,
            t_s=e.t_s[:-late].copy(),
            commands=e.commands[late:].copy(),
            observations=e.observations[:-late].copy(),
        )
        for e in episodes
    ]
    (finding,) = examine(plant, spoilt)
    assert finding.fault is Fault.TOPIC_OFFSET
    assert f"{1e3 * late * PERIOD_S:.4g} ms late" in finding.advice


@pytest.mark.parametrize(("late_s", "words"), [(0.03, "30 ms later"), (-0.03, "30 ms earlier")])
def test_topics_that_lie_apart_are_told_in_the_right_direction(arm, late_s, words):
    plant, episodes = arm
    (finding,) = examine(plant, [as_recorded(plant, e, late_s=late_s) for e in episodes])
    assert finding.fault is Fault.TOPIC_OFFSET
    assert words in finding.evidence
    assert ("move them back" in finding.advice) == (late_s > 0.0)


def test_a_message_that_was_logged_before_its_stamp_has_a_wrong_one(arm):
    plant, episodes = arm
    read = [as_recorded(plant, e) for e in episodes]
    spoilt = [replace(e, offset=replace(e.offset, latency_s=(-0.02, 0.001))) for e in read]
    (finding,) = examine(plant, spoilt)
    assert finding.fault is Fault.TOPIC_OFFSET
    assert "21 ms later" in finding.evidence
