"""Held starts: the states with which windows start where a fit holds them to what was observed.

A logged position is taken as it is. A velocity is known twice: as it was logged, and as the slope
of the positions around it. Windows start with the mean of both, each weighed by the inverse of its
variance. Source: W. G. Cochran, Journal of the Royal Statistical Society, Supplement 4 (1937).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from trueup.model.series import Series
from trueup.model.state import slope_deviation

Array = NDArray[np.float64]


def held_starts(s: Series, sigma: Array, hidden: Sequence[int] = ()) -> Array:
    """The state with which each window starts, `(windows, 2 x joints)`. `sigma` `(2 x joints,)` is
    the noise of positions and velocities, infinite where they were not observed. Of `hidden`
    joints, whose logged velocity lags, the slope alone counts."""
    joints = len(sigma) // 2
    by_slope = np.square(slope_deviation(s.period_s) * sigma[:joints])
    logged = np.square(sigma[joints:])
    with np.errstate(invalid="ignore"):
        counts = logged / (logged + by_slope)
    counts = np.where(np.isfinite(counts), counts, 0.0)  # smoothed already, or no position seen
    counts[list(hidden)] = 1.0
    begin = s.begin.copy()
    begin[:, joints:] += counts * (s.begin_by_positions - s.begin)[:, joints:]
    return begin
