"""One compiled step of many resampled futures of cumulative sums.

Futures are the innermost index, so that the compiler keeps them in vector registers.
"""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, error_model="numpy")
def add_block(state, total, high, low, rise, levels, alarms):  # type: ignore[no-untyped-def]
    """Adds one block to every sum of every future, and an alarm for each future that passes a
    level.

    Changes `state` `(levels, sums, futures)`, which begins again at 0 where a level is passed, and
    `alarms` `(levels,)`. `total`, `high`, `low` and `rise` of the block are `(sums, futures)`,
    `levels` is `(levels,)`.
    """
    sums, futures = total.shape
    highest = np.empty(futures)
    for at in range(len(levels)):
        highest[:] = -np.inf
        for k in range(sums):
            for i in range(futures):
                reached = max(state[at, k, i] + high[k, i], rise[k, i])
                highest[i] = max(highest[i], reached)
        for i in range(futures):
            if highest[i] > levels[at]:
                alarms[at] += 1.0
        for k in range(sums):
            for i in range(futures):
                further = max(state[at, k, i] + total[k, i], total[k, i] - low[k, i])
                state[at, k, i] = 0.0 if highest[i] > levels[at] else further
