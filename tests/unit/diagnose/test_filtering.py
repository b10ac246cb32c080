"""The filter's covariance stands still where it can, and stays finite where rounding does not let
it."""

import numpy as np
import pytest

from trueup.diagnose.filtering import LOST, _steady

UNIT = np.array([2.47, 1.01, 1.16])
NOISE = np.diag([0.0152, 0.0498]) ** 2
SHOWS = np.eye(2, 3) * UNIT
INFORMATION = SHOWS.T @ np.linalg.solve(NOISE, SHOWS)
FALLING = (
    np.array([[0.9998587, 0.01021044, 5e-5], [-0.01412994, 1.02104371, 0.01], [0.0, 0.0, 1.0]])
    * UNIT
    / UNIT[:, None]
)


@pytest.mark.parametrize("size", [1e-4, 1e-2, 1.0, 100.0])
def test_it_stands_still_under_one_more_observation_and_step(size):
    drive = 1e-16 * np.eye(3)
    drive[2, 2] += 0.01 * size**2
    p = _steady(FALLING, INFORMATION, drive)
    after = p - p @ SHOWS.T @ np.linalg.solve(SHOWS @ p @ SHOWS.T + NOISE, SHOWS @ p)
    assert FALLING @ after @ FALLING.T + drive == pytest.approx(
        p, rel=1e-6, abs=1e-9 * np.abs(p).max()
    )


def test_an_unstable_motion_that_hardly_anything_disturbs_leaves_a_finite_one():
    drive = 1e-16 * np.eye(3)
    drive[2, 2] *= 2.0
    p = _steady(FALLING, INFORMATION, drive)
    assert np.isfinite(p).all()
    assert np.abs(p).max() < LOST
