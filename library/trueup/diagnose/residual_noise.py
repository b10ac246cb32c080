"""Residual noise: the noise once more, from what a fitted composition leaves of the episodes.

The motion hides much of a sensor's noise, or a fast one is taken for it; what a model leaves has
little motion in it. So once the search has a fair model, noise is looked at again, and where it is
plainly other than it seemed, and a good part of what is left, the search begins again with what was
found.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from trueup.diagnose.candidate import Candidate
from trueup.diagnose.data_quality import DataQuality
from trueup.diagnose.noise import ChannelNoise, Track, differences, gain, noise_of
from trueup.diagnose.tuning import DATA_QUALITY
from trueup.diagnose.windowed_fits import WindowedFits, trajectory
from trueup.fit.rollout_fit import RolloutFit
from trueup.model.series import Series

Array = NDArray[np.float64]


def noise_left(fits: WindowedFits, candidate: Candidate) -> list[ChannelNoise | None]:
    """The noise of each position and velocity in what a candidate leaves of all episodes; None
    where it was not observed."""
    pairs = [(s, candidate.fit) for s in fits.adaptation] + [
        (s, candidate.check) for s in fits.validation
    ]
    left = [(s, _residual(fits, fit, s)) for s, fit in pairs]
    return [
        noise_of(
            [t for s, residual in left for t in _tracks(s, residual, column)],
            DATA_QUALITY.trimmed_residuals,
            DATA_QUALITY.residual_strides,
        )
        if np.isfinite(sigma)
        else None
        for column, sigma in enumerate(fits.fitter.sigma)
    ]


def noise_level(fits: WindowedFits, candidate: Candidate) -> float:
    """The reduced chi-square that noise alone leaves a candidate on validation episodes, 1 but
    where those hold more outliers than the rest."""
    power, count = 0.0, 0
    left = [(s, _residual(fits, candidate.check, s)) for s in fits.validation]
    for column, sigma in enumerate(fits.fitter.sigma):
        if np.isfinite(sigma):
            fourth = differences(
                [t for s, residual in left for t in _tracks(s, residual, column)], 1
            )
            power += (
                float(np.sum(fourth**2)) / gain(float(fits.fitter.correlation[column])) / sigma**2
            )
            count += len(fourth)
    return float(np.clip(power / max(count, 1), 1.0, DATA_QUALITY.most_outliers))


def quality_by_residuals(
    quality: DataQuality, fits: WindowedFits, candidate: Candidate
) -> DataQuality | None:
    """What the episodes are like with the noise of what a candidate leaves; None where that is as
    it seemed, or too little of what is left.
    """
    noise, correlation = quality.noise.copy(), quality.correlation.copy()
    left = noise_left(fits, candidate)
    for column, of_channel in enumerate(left):
        fine = np.isfinite(noise[column]) and not quality.lattice[column]
        if (
            of_channel is not None
            and fine
            and of_channel.sigma >= DATA_QUALITY.numerical_floor * quality.motion[column]
        ):
            noise[column], correlation[column] = of_channel.sigma, of_channel.correlation
    seen = np.isfinite(noise)
    ratio = noise[seen] / np.maximum(quality.noise[seen], 1e-300)
    other = (ratio > DATA_QUALITY.noise_changed) | (
        np.abs(correlation - quality.correlation)[seen] > DATA_QUALITY.correlation_changed
    )
    # less is left than was taken for noise: a fast motion had been taken for it
    below = candidate.reduced_chi_square < DATA_QUALITY.below_noise
    less = below and bool((ratio < 1.0 / DATA_QUALITY.noise_changed).any())
    if not less and (not other.any() or _over(fits, candidate, noise) > DATA_QUALITY.mostly_noise):
        return None
    return replace(
        quality,
        noise=noise,
        sigma=np.maximum(noise, DATA_QUALITY.numerical_floor * quality.motion),
        correlation=correlation,
    )


def _over(fits: WindowedFits, candidate: Candidate, noise: Array) -> float:
    """Mean power of what a candidate leaves of validation episodes, in that of the noise."""
    squares, count = 0.0, 0
    for s in fits.validation:
        counted = s.usable & np.isfinite(fits.fitter.sigma)
        residual = np.where(counted, _residual(fits, candidate.check, s), 0.0)
        squares += float(
            np.sum((residual / np.where(counted & np.isfinite(noise), noise, np.inf)) ** 2)
        )
        count += int(counted.sum())
    return squares / max(count, 1)


def _residual(fits: WindowedFits, fit: RolloutFit, s: Series) -> Array:
    """Observed less predicted, `(samples, 2 x joints)`."""
    return np.asarray(s.observed - trajectory(fits.fitter, fit, s))


def _tracks(s: Series, residual: Array, column: int) -> Sequence[Track]:
    """One channel of it, window by window: each window starts anew."""
    first = np.flatnonzero(s.resets >= 0)
    out = ~s.usable[:, column] | ~np.isfinite(residual[:, column])
    return list(
        zip(np.split(residual[:, column], first[1:]), np.split(out, first[1:]), strict=True)
    )
