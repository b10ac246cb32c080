"""The filter's covariance stands still where it can, and stays finite where rounding does not let
it; filters side by side are each as alone."""

import numpy as np
import pytest

from tests.support.simulated import recorded_twice
from trueup.diagnose.filtering import LOST, _steady
from trueup.diagnose.measure import windows_of
from trueup.model.block import FILTERS
from trueup.model.corrected import Corrected, side_by_side
from trueup.model.effect import effects
from trueup.model.hypothesis import Hypothesis
from trueup.model.series import Scheme

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


@pytest.fixture(scope="module")
def recorded():
    return recorded_twice("A1", ["quadratic_drag"], 21)[:2]


@pytest.mark.parametrize("name", ["", *effects()])
def test_filters_side_by_side_are_each_as_alone(recorded, name):
    plant, episodes = recorded
    hypothesis, rng = Hypothesis((name,) if name else ()), np.random.default_rng(4)
    values = plant.block.nulls.copy()
    values[: len(plant.parameters)] = plant.parameters
    for row in plant.block.rows(name) if name else ():
        values[row] = 0.02
    models = [
        Corrected(
            plant,
            hypothesis,
            tuple(map(float, values)),
            Scheme(0.5, 1),
            tuple(tuple(map(float, row)) for row in rng.uniform(0.0, 0.3, (3, 8))),
        )
        for _ in range(FILTERS - 1)
    ]
    windows = windows_of(plant, episodes[:2], 0.5, beginnings=True)
    beginnings = [models[0].beginning(w) for w in windows]
    for model, together in zip(models, side_by_side(models, beginnings, windows), strict=True):
        for given, alone in zip(together, model.rollouts(windows), strict=True):
            assert np.array_equal(given, alone, equal_nan=True)
