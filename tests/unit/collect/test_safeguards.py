"""Structured safeguards: each bound with who enforces it and of what that is independent, held
against the recording; free text is kept and cannot be checked."""

import json
from dataclasses import replace

import numpy as np
import pytest

from tests.support.made import episode_bytes, plant_document
from trueup.collect.measured import measured
from trueup.collect.required import refusal_of
from trueup.episode.episode import Episode
from trueup.episode.mcap import read_episode
from trueup.episode.role import Role
from trueup.fit.identify import identify
from trueup.model.plant import Plant

PLANT = Plant.from_document(plant_document())
SWITCHES = {"enforced_by": "limit switches", "independent_of": "the controller"}
GUARD = {"signal": "q", "low": -0.8, "high": 0.8, **SWITCHES}
STOP = {
    "signal": "q",
    "high": 0.6,
    "enforced_by": "emergency stop",
    "independent_of": "the computer",
    "within_s": 0.5,
}


def swing(positions, **conditions):
    """A recording of positions at 20 Hz, and what was declared of it."""
    q = np.asarray(positions, float)
    v = np.gradient(q, 0.05)
    t_s = 0.05 * np.arange(len(q))
    said = {
        name: json.dumps(x) if isinstance(x, dict | list) else x for name, x in conditions.items()
    }
    seen = np.stack([q, v], axis=1)
    commands = 0.5 * np.sin(t_s)[:, None]
    return Episode(
        t_s, commands, seen, PLANT.layout, Role.ADAPTATION, {"stage": "physical", **said}, 0, "d"
    )


QUIET = 0.5 * np.sin(0.1 * np.arange(100))
FAR = 0.95 * np.sin(0.1 * np.arange(100))


def guards_of(episode):
    record = measured(PLANT, episode)
    return record["safeguards"], record["warnings"]


def test_bounds_that_were_met_hold():
    record, warnings = guards_of(swing(QUIET, safeguards=[GUARD], stop_criterion=STOP))
    assert (record["checked"], record["held"]) == (True, True)
    assert record["safeguards"] == [{**GUARD, "met": True}]
    assert record["stop_criterion"]["reached"] is False
    assert not any("safeguard" in w or "stop" in w for w in warnings)


def test_a_bound_that_was_broken_says_where_and_who_should_have_kept_it():
    record, warnings = guards_of(swing(FAR, safeguards=[GUARD]))
    (broken,) = record["safeguards"]
    assert broken["met"] is False
    assert broken["samples"] == int((np.abs(FAR) > 0.8).sum())
    assert broken["first_s"] == pytest.approx(0.05 * np.argmax(np.abs(FAR) > 0.8))
    assert any(
        "q stays within [-0.8, 0.8], enforced by limit switches, was broken" in w for w in warnings
    )


def test_a_run_that_stops_where_it_said_holds_and_one_that_goes_on_does_not():
    until = int(np.argmax(FAR > 0.6))
    stopped = np.concatenate([FAR[: until + 4], np.full(40, FAR[until + 3])])
    for positions, held in ((stopped, True), (FAR, False), (FAR[: until + 5], True)):
        record, warnings = guards_of(swing(positions, safeguards=[GUARD], stop_criterion=STOP))
        stop = record["stop_criterion"]
        assert (stop["reached"], stop["held"]) == (True, held)
        assert stop["reached_s"] == pytest.approx(0.05 * until)
        assert any("did not stop where it said" in w for w in warnings) is not held


def test_a_bound_may_be_on_a_command_and_one_sided():
    record, _ = guards_of(swing(QUIET, safeguards=[{"signal": "u", "high": 0.3, **SWITCHES}]))
    assert record["safeguards"][0]["met"] is False
    record, _ = guards_of(swing(QUIET, safeguards={"signal": "u", "low": -0.6, **SWITCHES}))
    assert record["safeguards"][0]["met"] is True


def test_free_text_is_kept_and_not_checked():
    record, warnings = guards_of(
        swing(FAR, safeguards="torque limit", stop_criterion="|q| > 0.8", supervisor="ada")
    )
    assert record == {
        "checked": False,
        "held": None,
        "safeguards": [],
        "stop_criterion": None,
    }
    assert not any("safeguard" in w for w in warnings)


@pytest.mark.parametrize(
    ("guard", "says"),
    [
        ({**GUARD, "independent_of": ""}, "independent_of"),
        ({k: v for k, v in GUARD.items() if k != "independent_of"}, "independent_of"),
        ({k: v for k, v in GUARD.items() if k != "enforced_by"}, "enforced_by"),
        ({"signal": "q", **SWITCHES}, "needs low or high"),
        ({**GUARD, "low": "far"}, "low"),
        ({**GUARD, "within_s": 1.0}, "within_s"),
        ([], "0 entries"),
        ("[broken", "cannot be checked"),
        ("[" * 4000, "cannot be checked"),
    ],
)
def test_what_is_no_safeguard_is_said_and_refuses_nothing(guard, says):
    given = guard if isinstance(guard, list | str) else [guard]
    record, warnings = guards_of(swing(QUIET, safeguards=given))
    assert record["checked"] is False
    assert any("cannot be checked" in w and says in w for w in warnings), warnings


def test_a_signal_that_nobody_recorded_tells_nothing():
    record, warnings = guards_of(
        swing(QUIET, safeguards=[{**GUARD, "signal": "torque"}], stop_criterion=STOP)
    )
    assert (record["checked"], record["held"]) == (True, None)
    assert any("'torque', which is not in the recording" in w for w in warnings)


def test_a_policy_may_refuse_what_is_not_safeguarded():
    whole = {"safeguards": [GUARD], "stop_criterion": STOP}
    for episode, because in (
        (swing(QUIET, **whole), None),
        (swing(FAR, **whole), "breaks them"),
        (swing(QUIET), "does not declare"),
        (swing(QUIET, safeguards=[GUARD]), "does not declare"),
        (swing(QUIET, safeguards=[{**GUARD, "signal": "x"}], stop_criterion=STOP), "not tell"),
    ):
        summary = {"collection": measured(PLANT, episode)}
        refusal = refusal_of(summary, episode.conditions)
        assert refusal is None if because is None else because in refusal
    simulated = replace(swing(FAR), conditions={"stage": "MIL"})
    assert refusal_of({"collection": measured(PLANT, simulated)}, simulated.conditions) is None
    assert refusal_of({}, {"stage": "physical"}) is not None  # from before this was measured


def test_a_limit_that_no_command_reached_is_not_identified():
    quiet = read_episode(episode_bytes(1), PLANT.layout)
    loud = replace(quiet, commands=np.clip(5.0 * quiet.commands, -1.0, 1.0))
    for episode, count in ((replace(quiet, commands=0.5 * quiet.commands), 1), (loud, 0)):
        _, report = identify(PLANT, [episode])
        assert len(report.document()["not_identified"]) == count
        saturated = measured(PLANT, episode)["excitation"]["saturated"]["u"]
        assert (saturated == 0.0) is bool(count)
    (said,) = identify(PLANT, [replace(quiet, commands=0.5 * quiet.commands)])[1].not_identified
    assert "saturation of u: the limits [-1, 1] m/s^2 were not reached" in said
