"""VelocityPrior moments: the velocity that goes with a position and a command, where a log shows no
velocity.

A machine under a controller comes again and again through the same positions under the same
commands, so what it did there before tells how fast it is now. Used for a log's first sample alone:
from the second on there are two positions. Source: E. Fix, J. L. Hodges, USAF School of Aviation
Medicine Report 4 (1951), for the nearest ones.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
MOST = 4096  # moments that are kept
NEAREST = (0, 1, 4, 16)  # how many of them are asked
ASKED = 128  # of an episode's moments, to see how well the others' answer


@dataclass(frozen=True, eq=False)
class VelocityPrior:
    """Moments `(moments, 3)` of position, command and velocity.

    A velocity is a line through all of them, and what that misses, on the mean, at the `nearest`
    ones.
    """

    moments: Array
    nearest: int

    def __post_init__(self) -> None:
        if (
            self.moments.shape[1:] != (3,)
            or not len(self.moments)
            or not np.isfinite(self.moments).all()
        ):
            raise ValueError("moments are rows of position, command and velocity")

    @cached_property
    def _sizes(self) -> Array:
        spread = np.std(self.moments[:, :2], axis=0)
        return np.asarray(np.where(spread > 0.0, spread, 1.0))

    @cached_property
    def _line(self) -> Array:
        return np.asarray(
            np.linalg.lstsq(_terms(self.moments[:, :2]), self.moments[:, 2], rcond=None)[0]
        )

    @cached_property
    def _missed(self) -> Array:
        return np.asarray(self.moments[:, 2] - _terms(self.moments[:, :2]) @ self._line)

    def velocity(self, position: float, command: float) -> float:
        """The velocity to expect."""
        here = np.array([[position, command]])
        return float(self._by_number(here, (self.nearest,))[self.nearest][0])

    def _by_number(self, here: Array, numbers: Sequence[int]) -> dict[int, Array]:
        """The velocities `(places,)` to expect at positions and commands `(places, 2)`, by how many
        of the nearest moments are asked."""
        expected = _terms(here) @ self._line
        if not any(numbers):
            return dict.fromkeys(numbers, expected)
        apart = np.sum(((self.moments[:, :2] - here[:, None]) / self._sizes) ** 2, axis=2)
        order = np.argsort(apart, axis=1, kind="stable")[:, : max(numbers)]
        missed = self._missed[order]
        return {n: expected + missed[:, :n].mean(axis=1) if n else expected for n in numbers}


def velocity_prior(episodes: Sequence[Array]) -> tuple[VelocityPrior, float]:
    """Moments of episodes `(samples, 3)` each, as many asked as foretell an episode best from the
    others, and the rms of what they miss.

    One episode is foretold from its own other half.
    """
    parts = [e for e in episodes if len(e)]
    parts = parts if len(parts) > 1 else np.array_split(np.concatenate(episodes), 2)
    missed = _missed(parts)
    nearest = min(missed, key=lambda n: missed[n])
    return VelocityPrior(_thinned(np.concatenate(parts), MOST), nearest), missed[nearest]


def _missed(parts: Sequence[Array]) -> dict[int, float]:
    """The rms of what each number of nearest moments misses."""
    errors: dict[int, list[Array]] = {n: [] for n in NEAREST}
    for i, part in enumerate(parts):
        others = VelocityPrior(
            _thinned(np.concatenate([p for j, p in enumerate(parts) if j != i]), MOST), 0
        )
        asked = _thinned(part, ASKED)
        for n, expected in others._by_number(asked[:, :2], NEAREST).items():
            errors[n].append(expected - asked[:, 2])
    return {n: float(np.sqrt(np.mean(np.square(np.concatenate(e))))) for n, e in errors.items()}


def _terms(moments: Array) -> Array:
    return np.column_stack([np.ones(len(moments)), moments])


def _thinned(moments: Array, most: int) -> Array:
    return moments[:: -(-len(moments) // most)]
