"""Remainder: the noise once more, from what a fitted composition leaves of the episodes.

The motion hides much of a sensor's noise; what a model leaves has little motion in it. So once the
search has a fair model, noise is looked at again, and where it is plainly other than it seemed, and
a good part of what is left, the search begins again with what was found.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from trueup.diagnose.admission import NUMERICAL, Admission
from trueup.diagnose.noise import (
    ALMOST_ALL,
    FAR_STRIDES,
    ChannelNoise,
    Track,
    differences,
    gain,
    noise_of,
)
from trueup.diagnose.problem import Candidate, Problem, trajectory
from trueup.fit.rollout_fit import RolloutFit
from trueup.model.series import Series

Array = NDArray[np.float64]
# times: a standard deviation of noise that is another; a quarter more power would be no noise any
# more
LARGER = 1.1
OTHERWISE = 0.15  # a correlation that is another by so much
MOST_OUTLIERS = 2.0  # times the power of the noise; what leaves more is no outlier of a sensor
NOISY = 4.0  # times the noise's power at most: of more than that, noise is no good part


def noise_left(problem: Problem, candidate: Candidate) -> list[ChannelNoise | None]:
    """The noise of each position and velocity in what a candidate leaves of all episodes; None
    where it was not observed."""
    pairs = [(s, candidate.fit) for s in problem.adaptation] + [
        (s, candidate.check) for s in problem.validation
    ]
    left = [(s, _missed(problem, fit, s)) for s, fit in pairs]
    return [
        noise_of(
            [t for s, missed in left for t in _tracks(s, missed, column)], ALMOST_ALL, FAR_STRIDES
        )
        if np.isfinite(sigma)
        else None
        for column, sigma in enumerate(problem.fitter.sigma)
    ]


def noise_level(problem: Problem, candidate: Candidate) -> float:
    """The misfit that noise alone leaves a candidate on validation episodes, 1 but where those hold
    more outliers than the rest."""
    power, count = 0.0, 0
    left = [(s, _missed(problem, candidate.check, s)) for s in problem.validation]
    for column, sigma in enumerate(problem.fitter.sigma):
        if np.isfinite(sigma):
            fourth = differences([t for s, missed in left for t in _tracks(s, missed, column)], 1)
            power += (
                float(np.sum(fourth**2))
                / gain(float(problem.fitter.correlation[column]))
                / sigma**2
            )
            count += len(fourth)
    return float(np.clip(power / max(count, 1), 1.0, MOST_OUTLIERS))


def looked_again(admission: Admission, problem: Problem, candidate: Candidate) -> Admission | None:
    """What the episodes are like with the noise of what a candidate leaves; None where that is as
    it seemed, or too little of what is left.
    """
    noise, correlation = admission.noise.copy(), admission.correlation.copy()
    left = noise_left(problem, candidate)
    for column, found in enumerate(left):
        fine = np.isfinite(noise[column]) and not admission.lattice[column]
        if found is not None and fine and found.sigma >= NUMERICAL * admission.motion[column]:
            noise[column], correlation[column] = found.sigma, found.correlation
    seen = np.isfinite(noise)
    ratio = noise[seen] / np.maximum(admission.noise[seen], 1e-300)
    other = (ratio > LARGER) | (np.abs(correlation - admission.correlation)[seen] > OTHERWISE)
    if not other.any() or _over(problem, candidate, noise) > NOISY:
        return None
    return replace(
        admission,
        noise=noise,
        sigma=np.maximum(noise, NUMERICAL * admission.motion),
        correlation=correlation,
    )


def _over(problem: Problem, candidate: Candidate, noise: Array) -> float:
    """Mean power of what a candidate leaves of validation episodes, in that of the noise."""
    squares, count = 0.0, 0
    for s in problem.validation:
        counted = s.usable & np.isfinite(problem.fitter.sigma)
        missed = np.where(counted, _missed(problem, candidate.check, s), 0.0)
        squares += float(
            np.sum((missed / np.where(counted & np.isfinite(noise), noise, np.inf)) ** 2)
        )
        count += int(counted.sum())
    return squares / max(count, 1)


def _missed(problem: Problem, fit: RolloutFit, s: Series) -> Array:
    """Observed less predicted, `(samples, 2 x joints)`."""
    return np.asarray(s.observed - trajectory(problem.fitter, fit, s))


def _tracks(s: Series, missed: Array, column: int) -> Sequence[Track]:
    """One channel of it, window by window: each window starts anew."""
    first = np.flatnonzero(s.resets >= 0)
    out = ~s.usable[:, column] | ~np.isfinite(missed[:, column])
    return list(zip(np.split(missed[:, column], first[1:]), np.split(out, first[1:]), strict=True))
