"""Limits of commands: what was not activated is not identified."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from trueup.model.plant import Plant

Array = NDArray[np.float64]


def unsaturated(plant: Plant, commands: Array) -> tuple[str, ...]:
    """The saturation of each command that commands `(samples, commands)` did not activate, in
    words: what was not activated is not identified."""
    low, high = plant.limits
    lowest, highest = commands.min(axis=0), commands.max(axis=0)
    return tuple(
        f"saturation of {c.name}: the limits [{low[i]:g}, {high[i]:g}] {c.unit} were not reached, "
        f"by commands from {lowest[i]:.4g} to {highest[i]:.4g}"
        for i, c in enumerate(plant.layout.commands)
        if lowest[i] > low[i] and highest[i] < high[i]
    )
