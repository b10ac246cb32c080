"""Block: how the parameters of one hypothesis lie in the vector that the compiled rollout reads.

The family's own come first, then those of every effect in the order in which they act, then what each hidden state began with.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from trueup.model.effect import effects
from trueup.model.family import families

BLOCK = 16  # lanes: two AVX-512 or four AVX2 registers of float64


@cache
def layout() -> dict[str, tuple[int, ...]]:
    """Of each effect the rows of its parameters in a block; the family's own come first."""
    first = max(len(f.params) for f in families().values())
    rows = {}
    for name, effect in effects().items():
        rows[name] = tuple(range(first, first + len(effect.params)))
        first += len(effect.params)
    return rows


@cache
def rows_of(effect: str) -> dict[str, int]:
    """Rows of an effect's parameters, by name."""
    return {number.name: row for number, row in zip(effects()[effect].params, layout()[effect], strict=True)}


@cache
def memories() -> dict[tuple[str, str], int]:
    """Of each state of each effect the row that says how far from its usual value it began; behind all parameters."""
    states = [(e.name, s) for e in effects().values() for s, begins in zip(e.states, e.begins, strict=True) if begins != "first"]
    first = max(max(rows) for rows in layout().values()) + 1
    return {key: first + i for i, key in enumerate(states)}


@cache
def nulls() -> NDArray[np.float64]:
    """A block's rows in which nothing acts, `(rows,)`; those of the family, and what memories began with, are 0."""
    family = [0.0] * min(min(r) for r in layout().values())
    return np.array(family + [n.null for e in effects().values() for n in e.params] + [0.0] * len(memories()))
