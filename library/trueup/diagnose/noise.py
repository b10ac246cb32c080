"""Noise of a channel: how large it is, and how much of it each sample has from the one before, from
the samples alone.

Fourth differences take away what is smooth over five samples. Over samples further apart, white
noise leaves as much, coloured noise more and more, and a smooth motion or a kink much more. So
their sizes over several strides tell the noise's correlation beside what the motion leaves. A
channel is white unless the differences plainly say otherwise. What a fitted model leaves has hardly
any motion in it: there larger strides tell more, and outliers count. Source: J. von Neumann, Annals
of Mathematical Statistics 12 (1941), on successive differences; P. Hall, J. W. Kay, D. M.
Titterington, Biometrika 77 (1990), on differences of higher order.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter
from scipy.special import ndtri

from trueup.diagnose.tuning import DATA_QUALITY

Array = NDArray[np.float64]
Track = tuple[Array, NDArray[np.bool_]]
WEIGHTS = np.array([1.0, -4.0, 6.0, -4.0, 1.0])  # of a fourth difference
GAIN = 70.0  # of its power for white noise: the sum of the weights' squares
MEDIAN = 0.67449  # median of absolute standard normals


@dataclass(frozen=True, slots=True)
class ChannelNoise:
    """Standard deviation of a channel's noise, in its unit, and its correlation from one sample to
    the next."""

    sigma: float
    correlation: float


@dataclass(frozen=True, slots=True)
class Noise:
    """The noise of positions and velocities, `(2 x joints,)` each: `sigma` in their units, nan
    where not observed, and `correlation`."""

    sigma: Array
    correlation: Array

    def drawn(self, rng: np.random.Generator, samples: int, columns: NDArray[np.int64]) -> Array:
        """Normal noise of that size and colour, `(samples, columns)`."""
        noise = rng.normal(size=(samples, len(columns)))
        for i, kept in enumerate(self.correlation[columns]):
            noise[1:, i] *= np.sqrt(1.0 - kept**2)
            noise[:, i] = lfilter([1.0], [1.0, -kept], noise[:, i])
        return noise * np.nan_to_num(self.sigma[columns])


def gain(correlation: float, stride: int = 1) -> float:
    """Power of fourth differences of noise of power 1, over so many samples."""
    lags = correlation ** (stride * np.abs(np.subtract.outer(np.arange(5), np.arange(5))))
    return float(WEIGHTS @ lags @ WEIGHTS)


def noise_of(
    tracks: Sequence[Track],
    smallest: float = DATA_QUALITY.trimmed,
    strides: Sequence[int] = DATA_QUALITY.strides,
) -> ChannelNoise:
    """The noise of tracks, each with the samples that do not count, from the smallest part of their
    differences over some strides."""
    near = differences(tracks, 1)
    if not len(near):
        return ChannelNoise(0.0, 0.0)
    kept = np.sort(near)[: max(1, int(smallest * len(near)))]
    power = float(np.mean(kept**2)) / GAIN / _power_of_smallest(smallest)
    correlation, part = _correlation(strides, [differences(tracks, stride) for stride in strides])
    return ChannelNoise(float(np.sqrt(part * power * GAIN / gain(correlation))), correlation)


def _power_of_smallest(part: float) -> float:
    """Mean square of the smallest part of absolute standard normals."""
    end = float(ndtri((1.0 + part) / 2.0))
    return float(1.0 - 2.0 * end * np.exp(-0.5 * end**2) / np.sqrt(2.0 * np.pi) / part)


def differences(tracks: Sequence[Track], stride: int) -> Array:
    """Absolute fourth differences over so many samples of all tracks, those left out that a sample
    touches which does not count."""
    parts = [np.zeros(0)]
    for x, out in tracks:
        count = len(x) - 4 * stride
        if count > 0:
            shifted = [slice(k * stride, k * stride + count) for k in range(5)]
            fourth = sum(w * x[at] for w, at in zip(WEIGHTS, shifted, strict=True))
            touched = np.any([out[at] | ~np.isfinite(x[at]) for at in shifted], axis=0)
            parts.append(np.abs(np.asarray(fourth)[~touched]))
    return np.concatenate(parts)


def _correlation(strides: Sequence[int], over: Sequence[Array]) -> tuple[float, float]:
    """The correlation that fits differences over the strides, and which part of those over one
    sample is noise."""
    powers = np.array(
        [
            (float(np.median(d)) / MEDIAN) ** 2
            if len(d) > DATA_QUALITY.fewest_differences
            else np.nan
            for d in over
        ]
    )
    if not (
        np.isfinite(powers).all()
        and powers[0] > 0.0
        and powers[1] > DATA_QUALITY.coloured * powers[0]
    ):
        return 0.0, 1.0
    fits = {c: _fitted(c, strides, powers) for c in DATA_QUALITY.correlations}
    best = min(fits, key=lambda c: fits[c][0])
    return (
        (best, fits[best][1])
        if best and DATA_QUALITY.clearly_coloured * fits[best][0] < fits[0.0][0]
        else (0.0, 1.0)
    )


def _fitted(correlation: float, strides: Sequence[int], powers: Array) -> tuple[float, float]:
    """How far powers over the strides are from noise of a correlation and one kind of motion
    beside, and the noise's part of the first."""
    noise = np.array([gain(correlation, stride) for stride in strides]) / gain(correlation)
    fits = []
    for growth in DATA_QUALITY.motion_growth:
        motion = np.array(strides, np.float64) ** growth
        design = np.stack([noise, motion], axis=1) / powers[:, None]
        sizes = np.maximum(_two(design), 0.0)
        if not sizes.all():  # one of them alone
            sizes = np.array([float(design[:, 0].sum() / (design[:, 0] ** 2).sum()), 0.0])
        fits.append(
            (
                float(np.sum((design @ sizes - 1.0) ** 2)),
                float(np.clip(sizes[0] / powers[0], 0.0, 1.0)),
            )
        )
    return min(fits)


def _two(design: Array) -> Array:
    """Least squares of ones on two columns."""
    (a, b), (_, c) = design.T @ design
    right = design.sum(axis=0)
    return np.asarray(
        np.array([c * right[0] - b * right[1], a * right[1] - b * right[0]])
        / max(a * c - b * b, 1e-300)
    )
