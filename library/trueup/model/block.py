"""Block: how the parameters of one hypothesis lie in the vector that the compiled rollout reads.

The nominal form's own come first, then joint by joint those of every effect in the order in which
they act, then what each hidden state of that joint began with.

A *term* is one effect at one joint, written as the effect's name, and behind an @ the joint's
number where it is not the first.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
from numpy.typing import NDArray

from trueup.model.effect import Effect, effects
from trueup.model.family import families

BLOCK = 16  # lanes: two AVX-512 or four AVX2 registers of float64
FILTERS = BLOCK // 2  # lanes that filters may be, each followed by one of the others
AT = "@"
Memory = tuple[str, str]  # a term, and one of its hidden states


def term(effect: str, joint: int = 0) -> str:
    """An effect at a joint."""
    return f"{effect}{AT}{joint}" if joint else effect


def kind(of: str) -> type[Effect]:
    """The effect of a term."""
    return effects()[of.partition(AT)[0]]


def joint(of: str) -> int:
    """The joint of a term."""
    return int(of.partition(AT)[2] or 0)


@cache
def offsets() -> dict[str, tuple[int, ...]]:
    """Rows of each effect's parameters, counted from the first of its joint."""
    rows, first = {}, 0
    for name, effect in effects().items():
        rows[name] = tuple(range(first, first + len(effect.params)))
        first += len(effect.params)
    return rows


@cache
def memory_offsets() -> dict[Memory, int]:
    """Rows that say how far from its usual value each hidden state began, counted from the first of
    its joint."""
    states = [
        (e.name, s)
        for e in effects().values()
        for s, begins in zip(e.states, e.begins, strict=True)
        if begins != "first"
    ]
    first = sum(map(len, offsets().values()))
    return {key: first + i for i, key in enumerate(states)}


def height() -> int:
    """Rows of one joint."""
    return sum(map(len, offsets().values())) + len(memory_offsets())


@dataclass(frozen=True)
class Block:
    """Rows of a plant with `nominal` parameters of its own and so many joints."""

    nominal: int
    joints: int = 1

    @staticmethod
    def of_family() -> Block:
        """The block of a plant of any family: all families share one, so that a row means the same
        in each."""
        return Block(max(len(f.params) for f in families().values()))

    def rows(self, of: str) -> tuple[int, ...]:
        """Rows of a term's parameters."""
        first = self.nominal + joint(of) * height()
        return tuple(first + row for row in offsets()[kind(of).name])

    def rows_of(self, of: str) -> dict[str, int]:
        """Rows of a term's parameters by their names."""
        return {
            number.name: row for number, row in zip(kind(of).params, self.rows(of), strict=True)
        }

    @cached_property
    def memories(self) -> Mapping[Memory, int]:
        """Rows that say how far from its usual value each term's hidden states began."""
        at = memory_offsets().items()
        return {
            (term(e, j), state): self.nominal + j * height() + row
            for j in range(self.joints)
            for (e, state), row in at
        }

    @cached_property
    def nulls(self) -> NDArray[np.float64]:
        """Rows in which nothing acts, `(rows,)`; the nominal form's own, and what memories began
        with, are 0."""
        one = [n.null for e in effects().values() for n in e.params] + [0.0] * len(memory_offsets())
        return np.array([0.0] * self.nominal + one * self.joints)
