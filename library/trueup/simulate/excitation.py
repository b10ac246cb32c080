"""Excitation: command series that machines are recorded with."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
KEPT, SHOCK, LOUDNESS = 0.85, 0.15, 1.6  # of the smoothed noise
SHAPES = ("smooth", "multisine", "steps", "triangle")


def smoothed_noise(steps: int, rng: np.random.Generator) -> Array:
    """White noise through a first-order filter, `(steps,)` within +-1: x_t = 0.85 x_{t-1} + 0.15
    z_t, clip(1.6 x_t, +-1)."""
    x, series = 0.0, np.empty(steps)
    for t, z in enumerate(rng.standard_normal(steps)):
        x = KEPT * x + SHOCK * z
        series[t] = np.clip(LOUDNESS * x, -1.0, 1.0)
    return series


def planned(shape: str, samples: int, timestep_s: float, rng: np.random.Generator) -> Array:
    """A series `(samples,)` within +-1 of one of the SHAPES."""
    t = np.arange(samples) * timestep_s
    if shape == "smooth":
        keep = np.exp(-timestep_s / 0.3)
        shocks, x = rng.normal(size=samples), np.zeros(samples)
        for i in range(1, samples):
            x[i] = keep * x[i - 1] + np.sqrt(1.0 - keep * keep) * shocks[i]
        return np.clip(0.6 * x, -1.0, 1.0)
    if shape == "multisine":
        rates = np.exp(rng.uniform(np.log(0.1), np.log(2.0), 6))
        phases = rng.uniform(0.0, 2.0 * np.pi, 6)
        wave = np.sin(2.0 * np.pi * np.outer(t, rates) + phases).sum(axis=1)
        return np.asarray(wave / np.abs(wave).max() * rng.uniform(0.6, 1.0))
    if shape == "steps":
        series, at = np.zeros(samples), 0
        while at < samples:
            hold = max(1, int(rng.uniform(0.4, 2.0) / timestep_s))
            series[at : at + hold] = rng.uniform(-0.9, 0.9)
            at += hold
        return series
    period = rng.uniform(2.0, 6.0)
    return np.asarray(
        rng.uniform(0.7, 0.9) * (4.0 * np.abs((t / period + rng.uniform()) % 1.0 - 0.5) - 1.0)
    )
