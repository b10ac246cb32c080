"""Residual fits: ridge regression, on declared features, of what the nominal update misses."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueup.canonical import Json
from trueup.episode.episode import Episode
from trueup.fit.least_squares import ridge
from trueup.fit.transitions import transitions
from trueup.model.features import design, known_features, polynomial
from trueup.model.plant import Plant
from trueup.model.predictor import LinearMap, Residual

Array = NDArray[np.float64]
RIDGE = 1e-8  # penalty on every weight, of the normal equations


@dataclass(frozen=True, slots=True)
class ResidualFit:
    """Root mean square of what the nominal update misses in one step, before and after, per
    state."""

    features: tuple[str, ...]
    before_rms: tuple[float, ...]
    after_rms: tuple[float, ...]
    rows: int

    def document(self) -> dict[str, Json]:
        """The fit as JSON."""
        return {
            "features": list(self.features),
            "before_rms": list(self.before_rms),
            "after_rms": list(self.after_rms),
            "rows": self.rows,
        }


def fit_residual(
    plant: Plant,
    episodes: Sequence[Episode],
    features: Sequence[str] = (),
    penalty: float = RIDGE,
    progress: Callable[[float], None] = lambda _: None,
) -> tuple[Residual, ResidualFit]:
    """Ridge fit of (next state - nominal prediction) on features of state and issued command, from
    adaptation episodes alone.

    Where the velocity is observed every state has its residual. Where it is estimated, the
    velocity's residual is fitted over spans and the position's follows from the step: q' = q + h
    v'. Raises RoleRefused, BadArtifact for an unknown feature.
    """
    features = features or polynomial(len(plant.joints), len(plant.layout.commands))
    known_features(features, parameters=())
    data = transitions(plant, episodes)
    progress(0.3)
    miss = data.after - plant.update(data.states, data.issued, None, data.h_s)
    per_step = miss * (plant.timestep_s / data.h_s)[:, None]
    rows = data.sums(design(features, data.states, data.issued, {}))
    targets = data.sums(per_step)
    weights = ridge(rows, targets, penalty)
    if data.span > 1:
        joints = plant.dynamics.joints
        weights[:, :joints] = plant.timestep_s * weights[:, joints:]
    progress(1.0)
    rms = _rms(targets), _rms(targets - rows @ weights)
    return Residual(plant, LinearMap(tuple(features), weights)), ResidualFit(
        tuple(features), *rms, len(rows)
    )


def _rms(values: Array) -> tuple[float, ...]:
    return tuple(float(x) for x in np.sqrt(np.mean(values**2, axis=0)))
