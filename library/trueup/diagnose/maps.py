"""Maps: values of strides or samples as means over each pair of speed, command and time."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueup.canonical import Json
from trueup.diagnose.traces import number, numbers
from trueup.episode.layout import Field
from trueup.model.plant import Plant

Array = NDArray[np.float64]
CELLS = 16  # of a map at most, along speed and command; half as many again along time
FEWEST = 5
FILLED = 6.0  # values to a cell, as an average: fewer show noise
ENDS = 0.005  # of the values, at either end of an axis, that fall into its first and last cell
SCALE = 0.98  # of the cells: the part that a colour scale reaches
PAIRS = (("speed", "command"), ("time", "speed"), ("time", "command"))


@dataclass(frozen=True, eq=False)
class Places:
    """Where values were: a joint's speed, its command, and the time of the recording [s],
    `(values,)` each."""

    plant: Plant
    joint: int
    speed: Array
    command: Array
    time: Array


def maps(layers: Mapping[str, Array], places: Places) -> dict[str, Json]:
    """The means of each layer's values `(values,)`, all on one scale."""
    where = {"speed": places.speed, "command": places.command, "time": places.time}
    units = {"speed": _speed_unit(places), "command": _command_unit(places), "time": "s"}
    cells = int(np.clip(math.sqrt(len(places.time) / FILLED), FEWEST, CELLS))
    edges = {
        "speed": _edges(places.speed, cells),
        "command": _edges(places.command, cells),
        "time": np.linspace(0.0, float(places.time.max()), round(1.5 * cells) + 1),
    }
    inside = {
        axis: np.clip(np.digitize(where[axis], edges[axis]) - 1, 0, len(edges[axis]) - 2)
        for axis in edges
    }
    means = {
        layer: {
            f"{a}-{b}": _means(values, (inside[a], inside[b]), (edges[a], edges[b]))
            for a, b in PAIRS
        }
        for layer, values in layers.items()
    }
    reached = np.abs(
        np.concatenate([m[np.isfinite(m)] for of in means.values() for m in of.values()])
    )
    return {
        "scale": number(float(np.quantile(reached, SCALE))) if len(reached) else 0.0,
        "axes": {axis: {"unit": units[axis], "edges": numbers(edges[axis])} for axis in edges},
        "layers": {
            layer: {pair: [numbers(row) for row in m] for pair, m in of.items()}
            for layer, of in means.items()
        },
    }


def _means(
    values: Array, inside: tuple[NDArray[np.int64], NDArray[np.int64]], edges: tuple[Array, Array]
) -> Array:
    """Mean of the values in each cell, `(second, first)`, nan where nothing was recorded."""
    columns, rows = len(edges[0]) - 1, len(edges[1]) - 1
    fine = np.isfinite(values)
    cell = (inside[1] * columns + inside[0])[fine]
    count = np.bincount(cell, minlength=rows * columns)
    total = np.bincount(cell, values[fine], minlength=rows * columns)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan).reshape(rows, columns)


def _edges(values: Array, cells: int) -> Array:
    low, high = (float(np.nanquantile(values, q)) for q in (ENDS, 1.0 - ENDS))
    if high <= low:
        low, high = low - 0.5, high + 0.5
    return np.linspace(low, high, cells + 1)


def _speed_unit(places: Places) -> str:
    of = {
        c.field: c.unit
        for c in places.plant.layout.observations
        if places.plant.joint_of(c) == places.joint
    }
    return of.get(Field.VELOCITY) or f"{of.get(Field.POSITION, '1')}/s"


def _command_unit(places: Places) -> str:
    at = int(places.plant.command_columns[places.joint])
    return places.plant.layout.commands[at].unit if at >= 0 else "1"
