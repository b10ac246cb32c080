"""The compiled step of resampled futures does what its description says, on arrays."""

import numpy as np
import pytest

from trueup.monitor.futures import add_block

SUMS, FUTURES = 5, 40
LEVELS = np.array([0.5, 1.5, 3.0])


@pytest.mark.parametrize("seed", range(5))
def test_a_block_moves_every_sum_and_what_passes_a_level_begins_again(seed):
    rng = np.random.default_rng(seed)
    state = rng.exponential(size=(len(LEVELS), SUMS, FUTURES))
    total, high = rng.normal(size=(2, SUMS, FUTURES))
    low, rise = -rng.exponential(size=(SUMS, FUTURES)), rng.exponential(size=(SUMS, FUTURES))
    passed = np.maximum(state + high, rise).max(axis=1) > LEVELS[:, None]
    expected = np.where(passed[:, None, :], 0.0, np.maximum(state + total, total - low))
    alarms = np.ones(len(LEVELS))
    add_block(state, total, high, low, rise, LEVELS, alarms)
    assert 0 < passed.sum() < passed.size
    assert np.array_equal(state, expected)
    assert np.array_equal(alarms, 1.0 + passed.sum(axis=1))
