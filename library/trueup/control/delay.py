"""Delay: a signal as it is seen a whole number of samples late.

- Sample i of a delayed signal is sample max(0, i - delay): nothing looks ahead, and what was before
  the first sample is taken to be the first.
- A negative delay is none.
- A delay is a whole number; a float, a bool or anything else is refused.
- The result has the signal's shape and type, and is never a view of it.
"""

from __future__ import annotations

import operator
from typing import Any

import numpy as np
from numpy.typing import NDArray


def seen_at(sample: int, delay: int) -> int:
    """The sample that shows at `sample`, under a delay of whole samples. Raises TypeError for a
    delay that is no whole number."""
    return max(0, sample - _whole(delay))


def delayed(signal: NDArray[Any], delay: int) -> NDArray[Any]:
    """A signal `(samples, …)` seen `delay` samples late, as a new array of its shape and type.

    Raises TypeError for a delay that is no whole number, ValueError for a signal without samples'
    axis.
    """
    if signal.ndim == 0:
        raise ValueError("a signal has an axis of samples, this is one number")
    rows = np.arange(len(signal))
    return signal[np.maximum(rows - min(_whole(delay), len(signal)), 0)]


def _whole(delay: int) -> int:
    """A delay of zero samples or more."""
    if isinstance(delay, bool | np.bool_):
        raise TypeError(f"a delay is a whole number of samples, not {delay}")
    try:
        return max(0, operator.index(delay))
    except TypeError:
        raise TypeError(f"a delay is a whole number of samples, not {delay!r}") from None
