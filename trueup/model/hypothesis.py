"""Hypothesis: which effects act, and the sizes against which their parameters are measured."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueup.model.effect import Scale, effects


@dataclass(frozen=True, slots=True)
class Scales:
    """The plant's own sizes, against which parameters are measured."""

    position: float
    velocity: float
    acceleration: float
    command: float

    def of(self, scale: Scale) -> float:
        """The value of one unit of a scale."""
        time = self.position / self.velocity
        return {
            Scale.ACCELERATION: self.acceleration,
            Scale.VELOCITY: self.velocity,
            Scale.POSITION: self.position,
            Scale.COMMAND: self.command,
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
    """Which effects act; with none, the family alone."""

    effects: tuple[str, ...] = ()

    def __or__(self, name: str) -> Hypothesis:
        order = list(effects())
        return Hypothesis(tuple(sorted({*self.effects, name}, key=order.index)))

    def without(self, name: str) -> Hypothesis:
        """The same without one effect."""
        return Hypothesis(tuple(e for e in self.effects if e != name))


def switches(hypothesis: Hypothesis) -> NDArray[np.uint8]:
    """Which effects act, in the kernel's order, `(effects,)`."""
    return np.array([name in hypothesis.effects for name in effects()], np.uint8)
