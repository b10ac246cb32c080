"""Parameter identification: the nominal form with the numbers that the data show."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from trueup.canonical import Json
from trueup.episode.episode import Episode
from trueup.errors import NotIdentifiable
from trueup.fit.least_squares import solve
from trueup.fit.transitions import Transitions, transitions
from trueup.model.dynamics import CompiledFamily
from trueup.model.plant import Plant
from trueup.model.predictor import Identified

WORST_CONDITION = 1e6  # of the scaled design: beyond this half of float64's digits are gone


@dataclass(frozen=True, slots=True)
class Identification:
    """Parameters with 95 % half-widths, and how well the data determine them.

    `rank` is the rank of the regression, `condition` its condition number with columns of unit length; `residual_rms` is in
    acceleration units. `health` is empty, or says what speaks against the result.
    """

    parameters: dict[str, float]
    half_widths: dict[str, float]
    rank: int
    condition: float
    residual_rms: float
    rows: int
    health: tuple[str, ...]

    def document(self) -> dict[str, Json]:
        """The same as JSON."""
        estimates: dict[str, Json] = {
            name: {"value": value, "ci95": [value - self.half_widths[name], value + self.half_widths[name]]}
            for name, value in self.parameters.items()
        }
        return {
            "parameters": estimates,
            "rank": self.rank,
            "condition": self.condition,
            "residual_rms": self.residual_rms,
            "rows": self.rows,
            "health": list(self.health),
        }


def identify(
    plant: Plant, episodes: Sequence[Episode], progress: Callable[[float], None] = lambda _: None
) -> tuple[Identified, Identification]:
    """Least squares of the velocity's change on the family's regressors, from adaptation episodes alone.

    Equation: (v' - v) / h = sum of parameter x regressor(q, v, applied u); a velocity that is estimated enters over spans.
    Raises RoleRefused, and NotIdentifiable where the regression's rank is below the number of parameters.
    """
    data = transitions(plant, episodes)
    progress(0.5)
    design, target = _regression(plant, data)
    found = solve(design, target, data.span)
    names = plant.dynamics.parameter_names
    if found.rank < len(names) or found.condition > WORST_CONDITION:
        raise NotIdentifiable(
            f"the regression has rank {found.rank} of {len(names)} and condition {found.condition:.3g}",
            rank=found.rank,
            condition=found.condition,
        )
    values = tuple(float(x) for x in found.values)
    health = () if plant.is_stable(values) or not plant.is_stable() else ("the identified update is unstable, the nominal one is not",)
    pairs = dict(zip(names, values, strict=True)), dict(zip(names, map(float, found.half_widths), strict=True))
    progress(1.0)
    return Identified(plant, values), Identification(*pairs, found.rank, found.condition, found.residual_rms, len(target), health)


def _regression(plant: Plant, data: Transitions) -> tuple[np.ndarray, np.ndarray]:
    assert isinstance(plant.dynamics, CompiledFamily)
    joints = plant.dynamics.joints
    regressors = plant.dynamics.family.regressors(data.states[:, 0], data.states[:, joints], plant.applied(data.issued)[:, 0])
    spans = data.sums(data.h_s)
    design = data.sums(np.stack(regressors, axis=1) * data.h_s[:, None]) / spans[:, None]
    return design, data.sums(data.after[:, joints] - data.states[:, joints]) / spans
