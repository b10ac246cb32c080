"""Hypothesis: which effects act at which joints, and the sizes against which their parameters are
measured."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from trueup.model.block import Block, joint, kind
from trueup.model.effect import Scale, effects

Array = NDArray[np.float64]


@cache
def _order() -> dict[str, int]:
    """The place of each effect in the kernel's order, by its name."""
    return {name: place for place, name in enumerate(effects())}


@dataclass(frozen=True, slots=True)
class Scales:
    """A joint's own sizes, against which parameters are measured. `error` is that of a servo's goal
    beyond its position; without, the command's own drives the joint.
    """

    position: float
    velocity: float
    acceleration: float
    command: float
    error: float = 0.0

    def of(self, scale: Scale) -> float:
        """The value of one unit of a scale."""
        time = self.position / self.velocity
        return {
            Scale.ACCELERATION: self.acceleration,
            Scale.VELOCITY: self.velocity,
            Scale.POSITION: self.position,
            Scale.COMMAND: self.command,
            Scale.DRIVE: self.error or self.command,
            Scale.RATE: self.command / time,
            Scale.TIME: time,
            Scale.ONE: 1.0,
            Scale.DRAG: self.acceleration / self.velocity**2,
            Scale.CUBIC: self.acceleration / self.position**3,
            Scale.DRIFT: self.position / time / 10.0,
            Scale.STIFFNESS: self.acceleration / self.position,
            Scale.DAMPING: self.acceleration / self.velocity,
        }[scale]


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """Which terms act, in the order in which they do, the first joint's first; with none, the
    nominal form alone."""

    effects: tuple[str, ...] = ()

    def __or__(self, term: str) -> Hypothesis:
        order = _order()
        return Hypothesis(
            tuple(sorted({*self.effects, term}, key=lambda t: (joint(t), order[kind(t).name])))
        )

    def without(self, term: str) -> Hypothesis:
        """This hypothesis without one term."""
        return Hypothesis(tuple(e for e in self.effects if e != term))


def begun(block: Block, values: Array, scales: Scales, term: str, start: Sequence[float]) -> Array:
    """A block's values `(rows,)` with one term begun at a start, given in units of its joint's
    scales."""
    values = values.copy()
    for row, number, x in zip(block.rows(term), kind(term).params, start, strict=True):
        values[row] = (
            number.null
            if np.isnan(x)
            else np.clip(x, number.low, number.high) * scales.of(number.scale)
        )
    return values


def switches(hypothesis: Hypothesis, joints: int = 1) -> NDArray[np.uint8]:
    """Which effects act at which joints, in the kernel's order, `(effects, joints)`."""
    order = _order()
    on = np.zeros((len(order), joints), np.uint8)
    for term in hypothesis.effects:
        on[order[kind(term).name], joint(term)] = 1
    return on
