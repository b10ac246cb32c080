"""Cells: the matrix of conditions under which held-out episodes were recorded.

A gate names the conditions that matter, such as payload and speed; each held-out episode lies in
the cell of the values that its log declares. A cell without an episode counts as not covered, never
as passed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import product
from math import prod

import numpy as np
from numpy.typing import NDArray

from trueup.canonical import Json
from trueup.episode.episode import Episode

UNDECLARED = "undeclared"
MOST = 400  # cells of a matrix that is told whole: of a larger one those that are covered
Cell = tuple[str, ...]


def cell_of(declared: Mapping[str, str], conditions: Sequence[str]) -> Cell:
    """The values of the conditions that matter, in their order; `undeclared` for one that the log
    does not declare."""
    return tuple(declared.get(name, UNDECLARED) for name in conditions)


def cells_of(episodes: Sequence[Episode], conditions: Sequence[str]) -> tuple[Cell, ...]:
    """Each episode's cell."""
    return tuple(cell_of(e.conditions, conditions) for e in episodes)


def cell_words(cell: Cell, conditions: Sequence[str]) -> str:
    """A cell in words, for people."""
    return (
        ", ".join(f"{name} {value}" for name, value in zip(conditions, cell, strict=True))
        or "all episodes"
    )


def matrix(
    cells: Sequence[Cell],
    conditions: Sequence[str],
    candidate: NDArray[np.float64],
    incumbent: NDArray[np.float64],
) -> list[Json]:
    """Every combination of the values that occur, with its mean errors and the number of episodes
    that cover it; without an episode, null and 0.

    Of more than MOST combinations, only those that are covered.
    """
    values = [sorted({cell[i] for cell in cells}) for i in range(len(conditions))]
    rows: list[Json] = []
    every = list(product(*values)) if prod(len(v) for v in values) <= MOST else sorted(set(cells))
    for cell in every:
        inside = np.array([c == cell for c in cells])
        means = [float(x[inside].mean()) if inside.any() else None for x in (candidate, incumbent)]
        rows.append(
            {
                "cell": dict(zip(conditions, cell, strict=True)),
                "episodes": int(inside.sum()),
                "candidate": means[0] if means[0] is None or np.isfinite(means[0]) else None,
                "incumbent": means[1] if means[1] is None or np.isfinite(means[1]) else None,
            }
        )
    return rows
