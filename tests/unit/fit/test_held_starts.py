"""Windows start with the velocity that is known best: logged, or by the positions around it."""

from types import SimpleNamespace

import numpy as np
import pytest

from trueup.fit.held_starts import held_starts
from trueup.model.state import slope_deviation

RNG = np.random.default_rng(7)
PERIOD_S = 0.02


def windows(logged, by_positions):
    """A series of one joint with a position of 1 and two accounts of the velocity."""
    return SimpleNamespace(
        begin=np.column_stack([np.ones(len(logged)), logged]),
        begin_by_positions=np.column_stack([np.ones(len(logged)), by_positions]),
        period_s=PERIOD_S,
    )


def test_the_deviation_of_a_slope_is_that_of_a_parabola_through_noise():
    t = PERIOD_S * np.arange(-2, 3)
    slopes = np.polyfit(t, RNG.normal(size=(5, 4000)), 2)[1]
    assert np.std(slopes) == pytest.approx(slope_deviation(PERIOD_S), rel=0.05)


def test_two_accounts_of_a_velocity_count_by_the_inverse_of_their_variances():
    logged, by_positions = RNG.normal(0.0, 0.2, 4000), RNG.normal(0.0, 0.1, 4000)
    sigma = np.array([0.1 / slope_deviation(PERIOD_S), 0.2])
    position, velocity = held_starts(windows(logged, by_positions), sigma).T
    assert np.array_equal(position, np.ones(4000))
    assert np.std(velocity) == pytest.approx(0.2 / np.sqrt(5.0), rel=0.05)


@pytest.mark.parametrize(
    ("sigma", "hidden", "expected"),
    [
        pytest.param([1e-3, 0.0], [], 3.0, id="an exact velocity is taken as it is"),
        pytest.param([0.0, 0.1], [], 5.0, id="exact positions say the velocity"),
        pytest.param([np.inf, 0.1], [], 3.0, id="without positions the velocity is all there is"),
        pytest.param([1e-3, np.inf], [], 3.0, id="a velocity not observed was smoothed already"),
        pytest.param([1e-3, 0.0], [0], 5.0, id="a velocity that comes late does not count"),
    ],
)
def test_what_is_not_known_does_not_count(sigma, hidden, expected):
    start = held_starts(windows(np.array([3.0]), np.array([5.0])), np.array(sigma), hidden)
    assert start[0, 1] == pytest.approx(expected)
