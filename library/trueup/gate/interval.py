"""Interval: how far the ratio of two errors would move on other windows like these, by a paired
block bootstrap.

Windows of one recording follow each other, and what a model misses in one it tends to miss in the
next. So blocks of neighbouring windows are drawn, around the end of a recording to its beginning,
as many as it has; candidate and incumbent are drawn alike. Where every episode has one window only,
the episodes themselves are drawn. By hand, since scipy.stats.bootstrap draws no blocks. Source:
Künsch, "The jackknife and the bootstrap for general stationary observations" (1989); Politis and
Romano, "A circular block resampling procedure for stationary data" (1992); block length n^(1/3):
Hall, Horowitz and Jing (1995).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
RESAMPLES = 2000
LEVEL = 0.95
LEAST = 2  # windows, or episodes of one window: of one, nothing can be drawn
SEED = 0


@dataclass(frozen=True, slots=True)
class Pairs:
    """Errors of both models in the windows of one episode, `(windows,)` each, weighted by their
    samples, `(windows,)`."""

    candidate: Array
    incumbent: Array
    samples: Array


def ratio_interval(episodes: Sequence[Pairs]) -> tuple[float, float] | None:
    """The 95 % interval of the candidate's mean error over the incumbent's; None where nothing can
    be drawn or an error is not a number.

    The mean is over episodes, as a rule's is. The episodes are fixed, and other windows of them are
    drawn.
    """
    if not all(np.isfinite(p.candidate).all() and np.isfinite(p.incumbent).all() for p in episodes):
        return None
    rng = np.random.default_rng(SEED)
    drawn = (
        _episodes(episodes, rng)
        if all(len(p.samples) == 1 for p in episodes)
        else _windows(episodes, rng)
    )
    if drawn is None or not (drawn[1] > 0.0).all():
        return None
    low, high = np.quantile(drawn[0] / drawn[1], [(1.0 - LEVEL) / 2.0, (1.0 + LEVEL) / 2.0])
    return float(low), float(high)


def _episodes(episodes: Sequence[Pairs], rng: np.random.Generator) -> Array | None:
    """Means of both over drawn episodes, `(2, resamples)`."""
    if len(episodes) < LEAST:
        return None
    both = np.array([[p.candidate[0] for p in episodes], [p.incumbent[0] for p in episodes]])
    drawn: Array = both[:, rng.integers(0, len(episodes), (RESAMPLES, len(episodes)))].mean(axis=2)
    return drawn


def _windows(episodes: Sequence[Pairs], rng: np.random.Generator) -> Array:
    """Means of both over drawn blocks of each episode's windows, `(2, resamples)`."""
    total = np.zeros((2, RESAMPLES))
    for pairs in episodes:
        count = len(pairs.samples)
        length = max(1, round(count ** (1.0 / 3.0)))
        begins = rng.integers(0, count, (RESAMPLES, -(-count // length), 1))
        rows = ((begins + np.arange(length)) % count).reshape(RESAMPLES, -1)[:, :count]
        weights = pairs.samples[rows]
        total += np.stack(
            [
                (e[rows] * weights).sum(axis=1) / weights.sum(axis=1)
                for e in (pairs.candidate, pairs.incumbent)
            ]
        )
    return total / len(episodes)
