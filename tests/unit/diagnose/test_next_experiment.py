"""The experiment that would tell two answers apart."""

from dataclasses import replace

import numpy as np
import pytest

from tests.support.simulated import recorded_twice as recorded
from trueup.collect.bounds import Recorded
from trueup.collect.excitation import DETECTABLE
from trueup.diagnose.candidate import Candidate
from trueup.diagnose.data_quality import assess
from trueup.diagnose.model_selection import Choice, Conclusion
from trueup.diagnose.next_experiment import SHAPES, _command, next_experiment
from trueup.diagnose.problem_setup import Recordings, Setup
from trueup.diagnose.search import Search
from trueup.model.hypothesis import Hypothesis
from trueup.model.series import refined


@pytest.fixture(scope="module")
def case():
    plant, episodes, _ = recorded("A1", ["coulomb_friction"], 8)
    recordings = Recordings.of(plant, episodes)
    quality = assess(plant, recordings.adaptation)
    refitted = Setup(recordings, quality, refined(plant)).refitted(1)
    search = Search(refitted.problem, candidates={Hypothesis(): refitted.base})
    return plant, quality, search, recordings


def having(search, effect, part=0.3):
    """The nominal form with an effect of so many of its own sizes."""
    fit, fitter = search.base.fit, search.problem.fitter
    values = fitter.with_effect(fit.values, effect, [part] * len(fitter.block.rows(effect)))
    hypothesis = Hypothesis() | effect
    acting = replace(fit, hypothesis=hypothesis, values=values, free=fitter.free(hypothesis))
    return Candidate(acting, acting)


def experiment(case, winner, *rivals):
    plant, quality, search, recordings = case
    choice = Choice(Conclusion.EFFECT, winner, rivals, 0.0)
    bounds = Recorded.of(plant, recordings.adaptation)
    return next_experiment(plant, quality, search, choice, bounds)


def test_an_answer_without_an_alternative_needs_no_experiment(case):
    assert experiment(case, having(case[2], "coulomb_friction")) is None


def test_a_late_drive_of_one_joint_might_be_a_late_sensor_and_no_command_says_which(case):
    found = experiment(case, having(case[2], "actuator_delay", 0.05))
    assert found.splits == (("actuator_delay",), ("sensor_delay",))
    assert (found.command, found.document("command.csv")["command"]) == (None, None)
    assert "sensor's own clock" in found.why


def test_a_command_that_tells_two_answers_apart_stays_inside_the_limits(case):
    plant = case[0]
    winner, rival = (having(case[2], e) for e in ("coulomb_friction", "cubic_stiffness"))
    found = experiment(case, winner, rival)
    assert found.splits == (("coulomb_friction",), ("cubic_stiffness",))
    assert found.separation > DETECTABLE
    low, high = plant.limits
    assert ((found.command >= low) & (found.command <= high)).all()
    assert np.ptp(found.command) > 0.0
    text = found.csv(plant)
    assert len([x for x in text.splitlines() if x[0].isdigit()]) == len(found.t_s)


def test_where_no_envelope_is_declared_a_command_changes_no_faster_than_was_recorded(case):
    plant, quality, search, recordings = case
    assert plant.envelope
    case = replace(plant, envelope={}), quality, search, recordings
    winner, rival = (having(search, e) for e in ("coulomb_friction", "cubic_stiffness"))
    found = experiment(case, winner, rival)
    steps = np.abs(np.diff(found.command, axis=0)) / np.diff(found.t_s)[:, None]
    fastest = Recorded.of(plant, recordings.adaptation).rate
    assert 0.0 < steps.max() <= fastest * (1.0 + 1e-9)


def test_an_answer_is_not_told_from_itself(case):
    """Two terms whose numbers are at their nulls predict the same."""
    winner, rival = (having(case[2], e, 0.0) for e in ("coulomb_friction", "cubic_stiffness"))
    found = experiment(case, winner, rival)
    assert found.command is None
    assert found.separation < DETECTABLE
    assert "another load, is needed" in found.why


def test_aliases_are_told_apart_by_what_their_law_names(case):
    winner, rival = (having(case[2], e, 0.0) for e in ("constant_force", "sensor_bias"))
    assert "gauge or an end stop" in experiment(case, winner, rival).why


@pytest.mark.parametrize("shape", SHAPES)
def test_a_wave_fills_its_size_and_no_more(shape):
    wave = _command(shape, 1.0, np.linspace(0.0, 6.0, 1201))
    assert np.abs(wave).max() == pytest.approx(1.0, abs=0.01)
    assert np.abs(wave).max() <= 1.0
