"""A quantile of reference residuals as a cutoff, and alarms as runs beyond it.

A quantile is a cutoff, not a guarantee: the share of healthy samples beyond it is measured on other data, and a sample beyond it
is not an alarm. Runs never reach over the end of an episode.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Alarm:
    """A run of exceedances: where it starts in the episode, and where it is declared, once it is long enough."""

    episode: int
    starts_at: int
    declared_at: int


@dataclass(frozen=True, slots=True)
class QuantileThreshold:
    """The cutoff `level`, and the number of exceedances in a row that make an alarm."""

    level: float
    run: int = 3

    @staticmethod
    def calibrate(reference: Sequence[Array], quantile: float = 0.99, run: int = 3) -> QuantileThreshold:
        """The quantile of all reference residuals together."""
        return QuantileThreshold(float(np.quantile(np.concatenate(reference), quantile)), run)

    def exceedance(self, episodes: Sequence[Array]) -> float:
        """Share of the samples beyond the cutoff; on healthy data that it was not set on, its rate of false exceedances."""
        return float(np.mean(np.concatenate(episodes) > self.level))

    def alarms(self, episodes: Sequence[Array]) -> list[Alarm]:
        """Every run of at least `run` exceedances, each once."""
        found = []
        for index, residuals in enumerate(episodes):
            beyond = np.concatenate([[False], residuals > self.level, [False]])
            starts, ends = np.flatnonzero(np.diff(beyond.astype(np.int8))).reshape(-1, 2).T
            found += [Alarm(index, int(a), int(a) + self.run - 1) for a, b in zip(starts, ends, strict=True) if b - a >= self.run]
        return found
