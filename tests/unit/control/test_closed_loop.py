"""Closed loop: paired runs of two models on one machine, and a gate that can ask for no regression in tracking."""

from dataclasses import replace

import numpy as np
import pytest

from tests.support.made import TRUE, episode_bytes, plant_document
from trueup.control.closed_loop import CANNOT, SEEDS, TURNS, Tracking, compare
from trueup.episode.mcap import read_episode
from trueup.episode.role import Role
from trueup.errors import BadGate, NotIdentifiable
from trueup.fit.score import Scoring
from trueup.gate.decision import Gate
from trueup.gate.judge import judge, run_trial
from trueup.gate.rule import rules
from trueup.model.corrected import Corrected
from trueup.model.hypothesis import Hypothesis
from trueup.model.plant import Plant
from trueup.model.predictor import Identified, Nominal
from trueup.model.series import DECLARED

PLANT = Plant.from_document(plant_document())


def corrected(parameters, plant=PLANT, **effects):
    values, hypothesis = plant.block.nulls.copy(), Hypothesis()
    values[: len(parameters)] = parameters
    for name, numbers in effects.items():
        hypothesis = hypothesis | name
        for number, value in numbers.items():
            values[plant.block.rows_of(name)[number]] = value
    return Corrected(plant, hypothesis, tuple(map(float, values)), DECLARED)


MACHINE = corrected(TRUE)


def test_the_same_model_twice_tracks_the_same_to_the_last_digit():
    found = compare(MACHINE, MACHINE, corrected(TRUE), 0.5)
    assert np.array_equal(found.candidate, found.incumbent)
    assert len(found.candidate) == SEEDS * len(TURNS)
    document = found.document()
    assert (document["change"], document["change_ci95"], document["stage"]) == (0.0, [0.0, 0.0], "MIL")
    assert document["cannot_show"] == CANNOT


def test_a_model_that_is_wrong_about_its_drive_tracks_worse():
    weak = Identified(PLANT, (1.25, 0.62, -0.82))  # it believes that the drive pulls the other way
    found = compare(MACHINE, weak, MACHINE, 0.5)
    assert found.candidate.mean() > 2.0 * found.incumbent.mean()
    assert found.document()["change_ci95"][0] > 0.0


def test_the_envelope_says_how_far_the_reference_goes_and_breaches_are_counted():
    assert compare(MACHINE, MACHINE, MACHINE, 99.0).amplitude == pytest.approx(0.6 * 0.9)
    tight = Plant.from_document({**plant_document(), "envelope": {"q": [-0.9, 0.9], "v": [-0.01, 0.01]}})
    machine = corrected(TRUE, tight)
    assert compare(machine, machine, machine, 0.5).breaches[0] > 0.5


def test_what_the_machine_remembers_is_remembered_from_tick_to_tick():
    lazy = corrected(TRUE, actuator_lag={"time_constant": 0.4})
    alone, behind = compare(MACHINE, MACHINE, MACHINE, 0.5), compare(lazy, MACHINE, MACHINE, 0.5)
    assert behind.candidate.mean() > 1.2 * alone.candidate.mean()


def test_a_gate_can_refuse_a_better_prediction_that_tracks_worse():
    gate = Gate((rules()["rollout_improves"](), rules()["tracking_no_worse"]()), Scoring(2.0))
    episode = read_episode(episode_bytes(3, role=Role.VALIDATION), PLANT.layout)
    seen: list[float] = []
    found = run_trial(gate, MACHINE, Nominal(PLANT), [episode], seen.append)
    assert seen == sorted(seen)
    assert seen[-1] == pytest.approx(1.0)
    worse = replace(found, tracking=Tracking(found.tracking.incumbent * 1.2, found.tracking.incumbent, (0.0, 0.0), 0.5))
    breaching = replace(found, tracking=replace(found.tracking, candidate=found.tracking.incumbent, breaches=(0.1, 0.0)))
    for trial, passed in ((worse, False), (breaching, False), (replace(found, tracking=None), False)):
        verdicts = {v.rule: v for v in judge(gate, trial, plant="p", candidate="c", incumbent="i", generation=1).verdicts}
        assert verdicts["rollout_improves"].passed
        assert verdicts["tracking_no_worse"].passed is passed
    document = judge(gate, found, plant="p", candidate="c", incumbent="i", generation=1).document()
    assert document["figures"]["closed_loop"]["runs"] == len(found.tracking.candidate)


def test_without_a_diagnosed_machine_nothing_is_run():
    gate = Gate((rules()["tracking_no_worse"](),), Scoring(2.0))
    episode = read_episode(episode_bytes(3, role=Role.VALIDATION), PLANT.layout)
    with pytest.raises(BadGate, match="nobody has diagnosed"):
        run_trial(gate, Identified(PLANT, TRUE), Nominal(PLANT), [episode])


def test_a_robot_is_refused_for_the_planner_drives_one_joint(tmp_path):
    from tests.support.robots import arm_plant

    arm = arm_plant(tmp_path)
    machine = corrected(arm.parameters, arm)
    with pytest.raises(NotIdentifiable, match="one joint"):
        compare(machine, machine, machine, 0.5)


def test_runs_that_run_away_can_be_written_down_and_never_pass():
    found = Tracking(np.array([np.inf, 1.0]), np.ones(2), (0.0, 0.0), 1.0)
    assert found.document()["candidate"] is None
    assert found.document()["change_ci95"] is None
