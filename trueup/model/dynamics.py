"""Dynamics: how a state moves on under an applied command.

A state is positions, then velocities, `(n, 2 x joints)`; a command `(n, commands)`. `CompiledFamily` makes dynamics from
a family of one joint. Other makers, such as a robot given as MJCF, offer the same methods and nothing above asks which.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueup.model.family import Family

Array = NDArray[np.float64]


class Dynamics(ABC):
    """One semi-implicit Euler step, and many of them at once."""

    joints: int
    parameter_names: tuple[str, ...]

    @abstractmethod
    def step(self, state: Array, applied: Array, parameters: Array, h_s: Array | float) -> Array:
        """State after `h_s` [s]; parameters `(parameters,)` or `(parameters, n)`."""

    @abstractmethod
    def rollout(self, parameters: Array, initial: Array, applied: Array, h_s: Array, steps: NDArray[np.int64]) -> Array:
        """States at every sample, compiled, for all lanes.

        parameters `(vectors, parameters)`; initial `(windows, 2 x joints)`; applied `(windows, samples, commands)`; `h_s` [s] and
        `steps` `(windows, samples)`: between sample i and i+1 lie `steps[i]` steps of `h_s[i]`. A window stops where steps
        are 0. Returns `(vectors, windows, samples, 2 x joints)`.
        """

    @abstractmethod
    def transition(self, parameters: Array, h_s: float) -> Array:
        """The unforced update linearised at rest, `(2 x joints, 2 x joints)`."""


@dataclass(frozen=True)
class CompiledFamily(Dynamics):
    """One joint of a family; v' = v + h a(q, v, u), then q' = q + h v'."""

    family: type[Family]
    joints = 1

    @property
    def parameter_names(self) -> tuple[str, ...]:  # type: ignore[override]
        return tuple(p.name for p in self.family.params)

    def step(self, state: Array, applied: Array, parameters: Array, h_s: Array | float) -> Array:
        q, v = state[:, 0], state[:, 1]
        after = v + h_s * self.family.acceleration(q, v, applied[:, 0], *parameters)
        return np.stack([q + h_s * after, after], axis=1)

    def rollout(self, parameters: Array, initial: Array, applied: Array, h_s: Array, steps: NDArray[np.int64]) -> Array:
        from trueup.model.compose import rollout  # noqa: PLC0415  (numba loads slowly; a server that only serves needs none)

        return rollout(self.family, parameters, initial, applied[:, :, 0], h_s, steps)

    def transition(self, parameters: Array, h_s: float) -> Array:
        slope = 1e-6  # [rad, m] small against every joint's travel, large against rounding
        basis = slope * np.eye(2)
        moved = self.step(basis, np.zeros((2, 1)), parameters, h_s)
        return (moved / slope).T


def strictly_stable(dynamics: Dynamics, parameters: Array, h_s: float) -> bool:
    """Whether every eigenvalue of the unforced update at rest lies inside the unit circle."""
    return bool(np.abs(np.linalg.eigvals(dynamics.transition(parameters, h_s))).max() < 1.0)
