"""Correlations: which numbers of a fit are off together.

Where motion shows a sum of two numbers better than each, their errors go together: intervals alone
would allow pairs of values that the recordings rule out.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np

from trueup.canonical import Json
from trueup.diagnose.intervals import covariance
from trueup.fit.free_numbers import Directions
from trueup.fit.rollout_fit import RolloutFit
from trueup.model.plant import Plant

LEAST = 0.05  # a weaker correlation is none
DIGITS = 4


def correlations(fit: RolloutFit, directions: Directions, plant: Plant) -> list[Json]:
    """`[number, number, correlation]` of each pair of a fit's numbers that are off together, by
    their names in a family of plants."""
    names = [*plant.nominal, *(plant.number_name(*x) for x in fit.free.names if x[0])]
    ways = dict(zip(directions.names, directions.along, strict=True))
    along = np.zeros((len(names), len(fit.free.names)))  # what each free number moves of each
    row = len(plant.nominal)
    for k, (term, number) in enumerate(fit.free.names):
        if term:
            along[row, k] = 1.0
            row += 1
        else:
            along[: len(plant.nominal), k] = ways[number]
    spread = along @ covariance(fit) @ along.T
    deviation = np.sqrt(np.maximum(np.diag(spread), 0.0))
    pairs: list[Json] = []
    for i, j in combinations(np.flatnonzero(deviation > 0.0), 2):
        value = float(spread[i, j] / deviation[i] / deviation[j])
        if abs(value) >= LEAST:
            pairs.append([names[i], names[j], round(min(max(value, -1.0), 1.0), DIGITS)])
    return pairs
