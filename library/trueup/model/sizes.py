"""Sizes: how far and fast a joint moves, and what drives it, in recorded episodes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from trueup.episode.episode import Episode
from trueup.errors import NotIdentifiable
from trueup.model.hypothesis import Scales
from trueup.model.plant import Plant
from trueup.model.state import smoothed_states

Array = NDArray[np.float64]


def sizes_of(plant: Plant, episodes: Sequence[Episode]) -> tuple[Scales, ...]:
    """Each joint's own sizes over all episodes. Raises NotIdentifiable."""
    states = np.concatenate([smoothed_states(plant, e) for e in episodes])
    issued = np.concatenate([plant.applied(e.commands) for e in episodes])
    return tuple(sizes(plant, j, states, issued) for j in range(len(plant.joints)))


def sizes(plant: Plant, joint: int, states: Array, issued: Array) -> Scales:
    """A joint's own sizes. Raises NotIdentifiable where it does not move, or nothing drives it and
    no link beyond it could."""
    q, v = states[:, joint], states[:, len(plant.joints) + joint]
    known = np.isfinite(q) & np.isfinite(v)
    driven = plant.dynamics.drive(plant.parameters, joint, q[known], issued[known, joint])
    position, velocity, force = (
        float(np.abs(q[known]).max()),
        float(np.std(v[known])),
        float(np.sqrt(np.mean(driven**2))),
    )
    if plant.command_columns[joint] < 0:
        force = velocity**2 / position  # what its own motion needs
    if min(position, velocity, force) <= 0.0:
        raise NotIdentifiable(
            "the joint never moves, or no command was ever given",
            hint="Record episodes with a command that moves the joint.",
            joint=plant.joint_name(joint),
        )
    error = float(
        np.abs(
            issued[known, joint] - plant.dynamics.neutral(plant.parameters, joint, q[known])
        ).max()
    )
    return Scales(position, velocity, force, float(np.abs(issued[:, joint]).max()) or 1.0, error)
