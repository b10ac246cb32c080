"""Stepping: a nominal form with its effects, one step at a time, by numpy's functions on whatever
they can be called with.

The same text runs on arrays, and on symbols that write down what is done with them. It is the
compiled rollout's reference. `joint_step.py` steps one joint of a family, `tree_step.py` a robot.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any

from trueup.model.joint_effects import JointEffects, Memory

Columns = Sequence[Any]  # one for each joint, `(n,)`
Moved = tuple[Any, Any]  # a position and a velocity
After = tuple[Columns, Columns, Sequence[dict[str, Any]]]  # positions, velocities, memories


def between(x: Any, span_s: Any, before: Moved, after: Moved) -> Moved:
    """Position and velocity at a part `x` of the time `span_s` [s] between two samples of both, by
    the cubic that has their positions and velocities, and by a line."""
    (q0, v0), (q1, v1) = before, after
    rest = (1.0 - x) * span_s * v0 - x * span_s * v1 + (1.0 - 2.0 * x) * (q0 - q1)
    return (1.0 - x) * q0 + x * q1 + x * (1.0 - x) * rest, (1.0 - x) * v0 + x * v1


class Stepping(ABC):
    """Joints that step together. `labels` is what stands behind the name of a joint's state:
    nothing of one joint, `(joint)` in a robot."""

    effects: Sequence[JointEffects]
    labels: Sequence[str]

    @property
    @abstractmethod
    def sensor_is_late(self) -> bool:
        """Whether a late sensor is one; on the log of one joint it is a late drive."""

    @abstractmethod
    def begin(self, v: Columns, u: Columns) -> list[dict[str, Any]]:
        """What is remembered at the beginning of each joint, at velocities and under first
        commands."""

    @abstractmethod
    def advance(
        self, q: Columns, v: Columns, memory: Sequence[Memory], u: Columns, h: Any
    ) -> After:
        """Positions, velocities and memories `h` [s] later, under commands that are late already
        where they are late."""
