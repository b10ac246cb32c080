"""Free numbers: which numbers of a hypothesis a fit may move, in which directions, by which steps
and between which bounds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
STEP = 1e-4  # of a parameter's scale: a finite difference
CORNER_STEP = 3e-3  # of a parameter's scale, where the error has corners along it


@dataclass(frozen=True, slots=True)
class Directions:
    """The ways in which the numbers of a nominal form may move, `(directions, numbers)`, and what
    each is called.

    A family's are its parameters. A tree's are combinations that its data determine, and numbers
    by themselves. `alone` `(directions,)` is the number that moves by itself, -1 for a
    combination, `low` the least that it may be, `steps` are for finite differences, `nominal`
    `(numbers,)` what numbers are expected near, each within its size.
    """

    names: tuple[str, ...]
    along: Array
    determined: NDArray[np.bool_]  # which numbers the data show one by one, `(numbers,)`
    alone: NDArray[np.int64]
    steps: Array
    low: Array
    nominal: Array

    @staticmethod
    def of_family(names: Sequence[str]) -> Directions:
        """Each parameter by itself."""
        count = len(names)
        return Directions(
            tuple(names),
            np.eye(count),
            np.ones(count, np.bool_),
            np.arange(count),
            np.full(count, STEP),
            np.full(count, -np.inf),
            np.zeros(count),
        )


@dataclass(frozen=True, slots=True)
class Free:
    """The numbers that a hypothesis leaves free, `(free,)` each: rows in the block, -1 for a
    combination; names (term or "", number); finite-difference steps and bounds. `along` `(free,
    nominal numbers)` are the ways in which combinations move them.
    """

    rows: NDArray[np.int64]
    names: tuple[tuple[str, str], ...]
    step: Array
    low: Array
    high: Array
    along: Array
    central: bool = False  # whether differences are taken on both sides

    @property
    def alone(self) -> bool:
        """Whether each moves a number of its own, and none is a combination."""
        return bool((self.rows >= 0).all())

    def at(self, values: Array) -> Array:
        """Their values, `(free,)`; those of combinations up to a constant."""
        if self.alone:
            return np.asarray(values[self.rows])
        over = np.maximum(np.einsum("fr,fr->f", self.along, self.along), 1e-300)
        return np.asarray(
            np.where(
                self.rows >= 0, values[self.rows], self.along @ values[: self.along.shape[1]] / over
            )
        )

    def moved(self, values: Array, by: Array) -> Array:
        """The block's vector after steps `(free,)`, no further than to a bound."""
        after = values.copy()
        if self.alone:
            after[self.rows] = np.clip(values[self.rows] + by, self.low, self.high)
            return np.asarray(after)
        alone = self.rows >= 0
        after[: self.along.shape[1]] += np.where(alone, 0.0, by) @ self.along
        after[self.rows[alone]] = np.clip(
            values[self.rows[alone]] + by[alone], self.low[alone], self.high[alone]
        )
        return np.asarray(after)

    def nudge(
        self, p: Array, lanes: NDArray[np.int64], which: NDArray[np.int64], by: Array
    ) -> None:
        """Move some of them by steps `(some,)`, each in a lane of its own of vectors `p` `(rows,
        lanes)`, in place and past its bounds."""
        rows = self.rows[which]
        if self.alone:
            p[rows, lanes] += by
            return
        alone, combined = np.flatnonzero(rows >= 0), np.flatnonzero(rows < 0)
        p[rows[alone], lanes[alone]] += by[alone]
        ways = self.along[which[combined]].T
        p[: self.along.shape[1], lanes[combined]] += by[combined] * ways

    def none(self) -> Free:
        """Nothing free."""
        return Free(self.rows[:0], (), self.step[:0], self.low[:0], self.high[:0], self.along[:0])
