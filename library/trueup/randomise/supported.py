"""Supported: the randomisation ranges that a diagnosis supports.

Every number of the answer varies evenly over its 95 % interval, numbers that the fit ties together
by a Gaussian copula. An alternative that the data could
not tell from the answer is a kind of plant of its own, as likely as the answer: a policy that is
trained on one of several explanations is trained on a guess.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from trueup.canonical import Json
from trueup.collect.ensemble import Ensemble
from trueup.model.corrected import Corrected
from trueup.model.plant import Plant
from trueup.randomise.randomisation import SCHEMA

RANDOMISATION_FILE = "randomisation.json"
HAIR = 1e-9  # of a number: an interval has a width
LEAST_EIGENVALUE = 1e-3  # of a correlation matrix that rounding leaves one
WEAKER = 0.995  # each time that correlations are impossible together
DIGITS = 4  # of a correlation
TWO_SIDED = 1.96  # standard deviations of a 95 % interval


def supported_ranges(model: Corrected, report: Mapping[str, Any]) -> dict[str, Json] | None:
    """The family of plants that a diagnosis's report leaves possible, as a document; None where no
    number has an interval. Raises KeyError, TypeError, ValueError for another document."""
    evidence = report["evidence"]
    kinds = [Ensemble.posterior(model, report), *Ensemble.alternatives(model.plant, report)]
    tied = [evidence, *evidence.get("alternatives", [])]
    named = [
        {"numbers": numbers, **_tied(numbers, of.get("correlations", []))}
        for ensemble, of in zip(kinds, tied, strict=True)
        if (numbers := _numbers(ensemble))
    ]
    if not named:
        return None
    because = f"95 % intervals of a diagnosis of {report['plant']}, verdict {report['verdict']}"
    if len(named) > 1:
        because += f"; {len(named)} explanations that the data cannot tell apart"
    if report["verdict"] == "unknown_effect":
        because += "; a gap remains that these ranges do not cover"
    head: dict[str, Json] = {"schema": SCHEMA, "because": because}
    if len(named) == 1:
        return {**head, **named[0]}
    return {**head, "mixture": [{"weight": 1.0, **one} for one in named]}


def _tied(numbers: Sequence[Any], pairs: Sequence[Any]) -> dict[str, Json]:
    """The correlations of pairs of numbers that have a range, made a little weaker where rounding
    left them impossible together; none where nothing ties two of them."""
    names = [str(entry["number"]) for entry in numbers]
    matrix = np.eye(len(names))
    for first, second, value in pairs:
        if first in names and second in names:
            i, j = names.index(first), names.index(second)
            matrix[i, j] = matrix[j, i] = float(value)
    off = matrix - np.eye(len(names))
    while np.linalg.eigvalsh(np.eye(len(names)) + off)[0] < LEAST_EIGENVALUE:
        off *= WEAKER
    entries: list[Json] = [
        [names[i], names[j], round(float(off[i, j]), DIGITS)]
        for i, j in zip(*np.nonzero(np.triu(off)), strict=True)
    ]
    return {"correlation": entries} if entries else {}


def _numbers(ensemble: Ensemble) -> list[Json]:
    """The range of each unknown number of an ensemble."""
    names = _names(ensemble)
    numbers: list[Json] = []
    for row, spread in zip(ensemble.rows, ensemble.spread, strict=True):
        centre = float(ensemble.centre[row])
        half = max(TWO_SIDED * float(spread), HAIR * abs(centre))
        low, high = centre - half, centre + half
        if centre != 0.0:  # no number changes its sign
            low, high = (max(low, 0.0), high) if centre > 0.0 else (low, min(high, 0.0))
        if np.isfinite([low, high]).all() and low < high:
            number: dict[str, Json] = {"number": names[row], "distribution": "uniform"}
            numbers.append({**number, "low": low, "high": high})
    return numbers


def _names(ensemble: Ensemble) -> dict[int, str]:
    """The name of each row of an ensemble's block in a randomisation."""
    plant: Plant = ensemble.plant
    names = dict(enumerate(plant.dynamics.parameter_names))
    for term in ensemble.hypothesis.effects:
        for number, row in plant.block.rows_of(term).items():
            names[row] = plant.number_name(term, number)
    return names
