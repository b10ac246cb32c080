"""Bootstrap: a 95 % percentile interval of a statistic of independent observations.

With few observations it is too narrow: with four it covers their mean in about 80 % of cases, with
eight in 89 %.
Source: B. Efron, R. J. Tibshirani, An Introduction to the Bootstrap (1993), chapter 13.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
LEAST = 4  # observations: with three the interval covers the mean in 74 % of cases


def interval(
    samples: Sequence[Array],
    statistic: Callable[..., Array],
    resamples: int,
    rng: np.random.Generator,
) -> tuple[float, float] | None:
    """The interval of `statistic(*samples, axis)` of samples `(observations,)`, each drawn for
    itself; None where one has fewer than LEAST observations, or one that is not finite."""
    from scipy.stats import bootstrap  # noqa: PLC0415 - takes half a second to load

    if not all(len(sample) >= LEAST and np.isfinite(sample).all() for sample in samples):
        return None
    low, high = bootstrap(
        samples, statistic, n_resamples=resamples, method="percentile", rng=rng
    ).confidence_interval
    return float(low), float(high)
