"""Lanes: what a fit asks of blocks of rollouts, and how parameter vectors lie in them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueup.fit.free_numbers import Free
from trueup.model.hypothesis import Hypothesis
from trueup.model.series import Series

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Task:
    """What is fitted to what.

    `states` are the hidden ones whose past is estimated. Derivatives by the first `keeps` free
    numbers may be kept from one step to the next.
    """

    data: Sequence[Series]
    hypothesis: Hypothesis
    free: Free
    states: tuple[tuple[str, str], ...]
    keeps: int


@dataclass(frozen=True, slots=True)
class Lanes:
    """Parameter vectors `p` `(rows, lanes)` and the `inverse` of each lane's step `(lanes,)`.

    Lane 0 is unperturbed; `starts` lanes of windows' starts follow it, then the lanes `of` numbers,
    memories and what is screened. `against` are the lanes that their differences are taken from.
    """

    p: Array
    inverse: Array
    of: NDArray[np.int64]
    starts: int
    against: NDArray[np.int64]
