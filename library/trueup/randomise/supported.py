"""Supported: the randomisation ranges that a diagnosis supports.

Every number of the answer varies evenly over its 95 % interval. An alternative that the data could
not tell from the answer is a kind of plant of its own, as likely as the answer: a policy that is
trained on one of several explanations is trained on a guess.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from trueup.canonical import Json
from trueup.collect.ensemble import Ensemble
from trueup.model.block import joint, kind
from trueup.model.corrected import Corrected
from trueup.model.plant import Plant
from trueup.randomise.randomisation import SCHEMA

RANDOMISATION_FILE = "randomisation.json"
HAIR = 1e-9  # of a number: an interval has a width
TWO_SIDED = 1.96  # standard deviations of a 95 % interval


def supported_ranges(model: Corrected, report: Mapping[str, Any]) -> dict[str, Json] | None:
    """The family of plants that a diagnosis's report leaves possible, as a document; None where no
    number has an interval. Raises KeyError, TypeError, ValueError for another document."""
    kinds = [Ensemble.posterior(model, report), *Ensemble.alternatives(model.plant, report)]
    named = [numbers for ensemble in kinds if (numbers := _numbers(ensemble))]
    if not named:
        return None
    because = f"95 % intervals of a diagnosis of {report['plant']}, verdict {report['verdict']}"
    if len(named) > 1:
        because += f"; {len(named)} explanations that the data cannot tell apart"
    if report["verdict"] == "unknown_effect":
        because += "; a gap remains that these ranges do not cover"
    head: dict[str, Json] = {"schema": SCHEMA, "because": because}
    if len(named) == 1:
        return {**head, "numbers": named[0]}
    return {**head, "mixture": [{"weight": 1.0, "numbers": numbers} for numbers in named]}


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
        at = f"@{plant.joint_name(joint(term))}" if plant.names_joints else ""
        for number, row in plant.block.rows_of(term).items():
            names[row] = f"{kind(term).name}{at}.{number}"
    return names
