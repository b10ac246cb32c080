"""The bootstrap's interval: what it holds, and where it gives none."""

import numpy as np
import pytest

from trueup.bootstrap import interval

MEAN = np.mean


def drawn(samples, statistic=MEAN, resamples=400, seed=0):
    return interval(samples, statistic, resamples, np.random.default_rng(seed))


def test_an_interval_holds_the_mean_that_was_drawn_from_about_as_often_as_it_says():
    rng = np.random.default_rng(1)
    held = [
        low <= 2.0 <= high
        for seed in range(400)
        for low, high in [drawn([rng.normal(2.0, 1.0, 30)], seed=seed)]
    ]
    assert 0.91 <= np.mean(held) <= 0.98


def test_an_interval_is_as_wide_as_the_standard_error_of_the_mean():
    sample = np.random.default_rng(2).normal(0.0, 1.0, 400)
    low, high = drawn([sample], resamples=4000)
    assert (high - low) / 2.0 == pytest.approx(1.96 * sample.std() / 20.0, rel=0.06)


def test_two_samples_are_drawn_each_for_itself():
    now, before = np.array([2.0, 2.0, 4.0, 4.0]), np.ones(5)
    low, high = drawn([now, before], lambda x, y, axis: x.mean(axis=axis) / y.mean(axis=axis))
    assert (low, high) == (2.0, 4.0)


@pytest.mark.parametrize("samples", [[np.arange(3.0)], [np.arange(5.0), np.arange(3.0)]])
def test_of_few_observations_there_is_no_interval(samples):
    assert drawn(samples, lambda *x, axis: x[0].mean(axis=axis)) is None


@pytest.mark.parametrize("bad", [np.inf, np.nan])
def test_of_what_ran_away_there_is_no_interval(bad):
    assert drawn([np.array([1.0, 2.0, 3.0, bad])]) is None
