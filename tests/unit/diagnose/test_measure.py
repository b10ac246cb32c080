"""How far a gap closes: errors over windows, what does not count, and the noise's own part."""

from dataclasses import replace

import numpy as np
import pytest

from tests.support.simulated import recorded_twice as recorded
from trueup.diagnose.measure import (
    RAN_AWAY,
    Gap,
    closed_on,
    knows_beginnings,
    measure,
    squared_errors,
    windows_of,
)
from trueup.diagnose.noise import Noise
from trueup.episode.role import Role
from trueup.model.corrected import Corrected
from trueup.model.hypothesis import Hypothesis
from trueup.model.predictor import Identified, Nominal, predict_episode
from trueup.model.series import DECLARED


@pytest.fixture(scope="module")
def case():
    plant, episodes, _ = recorded("A1", ["coulomb_friction"], 4)
    return plant, [e for e in episodes if e.role is Role.VALIDATION]


def gap(**changes):
    standing = {
        "before": 1.0,
        "same_numbers": 0.9,
        "parameters_only": 0.5,
        "after": 0.2,
        "floor": 0.1,
    }
    return Gap(2.0, **(standing | changes), closed=0.9, ci95=None, by_channel={})


def said_by(model, episode):
    """The episode as a model says that it was, in one rollout."""
    whole = predict_episode(model, episode, episode.t_s[-1] + 1.0)
    return replace(episode, observations=whole)


@pytest.mark.parametrize(("after", "at"), [(0.1, True), (0.104, True), (0.106, False)])
def test_an_error_is_at_the_floor_up_to_a_tenth_more_power(after, at):
    assert gap(after=after).at_the_floor is at


@pytest.mark.parametrize(("before", "was"), [(0.1, True), (0.101, False)])
def test_a_nominal_model_that_errs_by_noise_has_no_gap(before, was):
    assert gap(before=before).was_at_the_floor is was


def test_a_model_that_says_what_was_recorded_has_no_error(case):
    plant, episodes = case
    episodes = [said_by(Nominal(plant), e) for e in episodes]
    windows = windows_of(plant, episodes, plant.horizon_s, beginnings=True)
    assert not squared_errors(Nominal(plant), windows, np.ones(2)).any()


def test_an_error_is_a_mean_over_samples_behind_the_first_in_units_of_the_motion(case):
    plant, (episode, *_) = case
    off = said_by(Nominal(plant), episode)
    off = replace(off, observations=off.observations + np.array([0.6, 0.0]))
    windows = windows_of(plant, [off], off.t_s[-1] + 1.0, beginnings=True)
    windows = [replace(w, initial=w.initial - np.array([0.6, 0.0])) for w in windows]
    (error,) = squared_errors(Nominal(plant), windows, np.array([0.3, 1.0]))
    assert error == pytest.approx((0.6 / 0.3) ** 2 / 2.0)  # the mean of two channels


def test_a_model_that_runs_away_has_the_largest_error_that_there_is(case):
    plant, episodes = case
    away = Identified(plant, (-1e4, -1e4, 1.0))
    windows = windows_of(plant, episodes, plant.horizon_s, beginnings=True)
    errors = squared_errors(away, windows, np.ones(2))
    assert np.isfinite(errors).all()
    assert 0.9 * RAN_AWAY**2 < errors.max() <= RAN_AWAY**2


def test_what_remembers_the_time_before_the_log_does_not_know_how_it_began(case):
    plant, episodes = case
    values = tuple(float(x) for x in plant.block.nulls)
    acting = Corrected(plant, Hypothesis() | "backlash", values, DECLARED)
    assert knows_beginnings(Corrected(plant, Hypothesis(), values, DECLARED))
    assert not knows_beginnings(acting)
    counted, left = (
        windows_of(plant, episodes, plant.horizon_s, beginnings=b)[0] for b in (True, False)
    )
    assert list(left.first) == list(counted.first[1:])


def test_a_window_that_is_alone_counts_whatever_it_knows(case):
    plant, episodes = case
    (only,) = windows_of(plant, episodes[:1], 1e3, beginnings=False)
    assert list(only.first) == [0]


def test_the_gap_is_closed_by_the_model_that_the_machine_is(case):
    """Half of the stiffness was wrong, and nothing else."""
    plant, episodes = case
    true = Identified(plant, (1.5 * plant.parameters[0], *plant.parameters[1:]))
    episodes = [said_by(true, e) for e in episodes]
    quiet = Noise(np.full(2, 1e-9), np.zeros(2))
    found = measure(*[Nominal(plant)] * 2, true, true, episodes, quiet, seed=0)
    assert (found.closed, found.after) == (pytest.approx(1.0), pytest.approx(0.0, abs=1e-12))
    assert found.before == found.same_numbers > 0.01
    assert found.ci95 == (pytest.approx(1.0), pytest.approx(1.0))
    assert closed_on(true, episodes, np.full(2, 1e-9)) == pytest.approx(1.0)
    assert closed_on(Nominal(plant), episodes, np.full(2, 1e-9)) == pytest.approx(0.0)


def test_where_there_was_no_gap_none_is_closed(case):
    plant, episodes = case
    episodes = [said_by(Nominal(plant), e) for e in episodes]
    found = measure(*[Nominal(plant)] * 4, episodes, Noise(np.full(2, 1e-3), np.zeros(2)), seed=0)
    assert (found.closed, found.ci95, found.was_at_the_floor) == (None, None, True)
    assert closed_on(Nominal(plant), episodes, np.full(2, 1e-3)) is None


def test_of_a_single_window_no_interval_is_given(case):
    plant, episodes = case
    true = Identified(plant, (1.5 * plant.parameters[0], *plant.parameters[1:]))
    whole = replace(plant, horizon_s=1e3)
    quiet = Noise(np.full(2, 1e-9), np.zeros(2))
    models = [Nominal(whole)] * 2 + [replace(true, plant=whole)] * 2
    found = measure(*models, [said_by(true, episodes[0])], quiet, seed=0)
    assert (found.closed, found.ci95) == (pytest.approx(1.0, abs=1e-3), None)
