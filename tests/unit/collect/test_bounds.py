"""How much of the room between a start and the envelope paths take."""

import numpy as np
import pytest

from tests.support.made import plant_document
from trueup.collect.bounds import Bounds
from trueup.model.plant import Plant

BOUNDS = Bounds.of(Plant.from_document(plant_document()), 8.0, margin=0.1)
START = np.array([0.2, -0.5])
PATHS = START + np.random.default_rng(0).normal(size=(30, 50, 2))


def test_it_is_the_largest_part_that_any_path_takes_to_either_side():
    low, high = BOUNDS.envelope.T
    parts = np.where(
        PATHS > START, (PATHS - START) / (high - START), (START - PATHS) / (START - low)
    )
    assert BOUNDS.used(PATHS, START) == pytest.approx(parts.max())
    assert BOUNDS.used(np.tile(START, (3, 4, 1)), START) == 0.0


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_a_path_that_runs_away_takes_more_than_there_is(value):
    lost = PATHS.copy()
    lost[17, 3, 1] = value
    assert BOUNDS.used(lost, START) == np.inf
