"""Bounds: what an excitation must keep, of command, rate, envelope, band and time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueup.errors import BadPlant
from trueup.model.plant import Plant

Array = NDArray[np.float64]
SMOOTHED = 0.85  # of a random excitation, from sample to sample: at 0.05 s the chapter's


@dataclass(frozen=True, slots=True)
class Bounds:
    """What an excitation must keep.

    `low` and `high` of the command `(joints,)`, `rate` [command/s] `(joints,)`, `envelope` `(2 x joints, 2)` of positions and velocities
    with its `margin` taken off, `band_hz`, `duration_s` [s] without the hold at the end.
    """

    low: Array
    high: Array
    rate: Array
    envelope: Array
    margin: float
    band_hz: tuple[float, float]
    duration_s: float

    @staticmethod
    def of(plant: Plant, duration_s: float, band_hz: tuple[float, float] | None, rate: float | None, margin: float) -> Bounds:
        """A plant's own. Without a rate a command may cross its range in a fifth of the shortest period of the band."""
        if not 0.0 <= margin < 1.0 or not duration_s > 0.0:
            raise BadPlant("an excitation needs a margin from 0 to below 1 and a positive duration", field="margin")
        joints = len(plant.joints)
        low, high = (np.where(plant.command_columns >= 0, bound[plant.command_columns], 0.0) for bound in plant.limits)
        band = band_hz or (1.0 / duration_s, min(0.1 / plant.timestep_s, 20.0 / duration_s))
        envelope = np.tile([-np.inf, np.inf], (2 * joints, 1))
        for channel, column in zip(plant.layout.observations, plant.state_columns, strict=True):
            if channel.name in plant.envelope:
                near, far = plant.envelope[channel.name]
                half, middle = (far - near) / 2.0, (far + near) / 2.0
                envelope[column] = middle - (1.0 - margin) * half, middle + (1.0 - margin) * half
        rates = np.full(joints, rate) if rate is not None else 5.0 * band[1] * np.maximum(high - low, 1e-12)
        return Bounds(low, high, rates, envelope, margin, band, duration_s)

    def inside(self, paths: Array) -> bool:
        """Whether every path `(…, samples, 2 x joints)` keeps the envelope less its margin."""
        low, high = self.envelope.T
        return bool(((paths >= low) & (paths <= high)).all())

    def declared(self) -> tuple[Array, Array]:
        """The envelope without its margin, `(2 x joints,)` each."""
        low, high = self.envelope.T
        declared = np.isfinite(low)
        near, far = np.where(declared, low, 0.0), np.where(declared, high, 0.0)
        middle, half = (near + far) / 2.0, (far - near) / 2.0 / (1.0 - self.margin)
        return np.where(declared, middle - half, -np.inf), np.where(declared, middle + half, np.inf)

    def random(self, hold: Array, like: Array, rng: np.random.Generator) -> Array:
        """Smoothed noise about a command `hold` `(joints,)`, of the energy of another one `(samples, joints)`, within the limits."""
        x = np.zeros_like(like)
        for i in range(1, len(x)):
            x[i] = SMOOTHED * x[i - 1] + (1.0 - SMOOTHED) * rng.standard_normal(x.shape[1])
        energy, size = np.sum((like - hold) ** 2), 1.0
        for _ in range(4):  # cutting off takes some of it
            cut = np.clip(hold + size * x, self.low, self.high)
            size *= float(np.sqrt(energy / max(np.sum((cut - hold) ** 2), 1e-300)))
        return np.clip(hold + size * x, self.low, self.high)
