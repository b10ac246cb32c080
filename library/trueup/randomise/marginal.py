"""Marginal: the distribution of one number of a randomised plant.

`{"number": "k", "distribution": "uniform", "low": 0.6, "high": 1.6}`, or any of DISTRIBUTIONS with
the shapes, `loc` and `scale` that scipy.stats gives it; `low` and `high` then cut it off.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy import stats

from trueup.canonical import Json
from trueup.errors import BadRandomisation
from trueup.model.fields import Reader

UNIFORM = "uniform"
# continuous ones of one number; heavy tails: t, cauchy, genpareto
DISTRIBUTIONS = (
    UNIFORM,
    "norm",
    "lognorm",
    "t",
    "cauchy",
    "laplace",
    "logistic",
    "genpareto",
    "gamma",
    "beta",
    "triang",
    "weibull_min",
)


@dataclass(frozen=True)
class Marginal:
    """One number's distribution, cut off at `low` and `high`; `document` is what it was read
    from."""

    document: Mapping[str, Json]
    frozen: Any  # of scipy.stats, which has no type for it
    low: float
    high: float

    @staticmethod
    def read(reader: Reader) -> Marginal:
        """The marginal that a document describes. Raises BadRandomisation at its field."""
        name = reader.choice("distribution", list(DISTRIBUTIONS))
        low = reader.number("low") if "low" in reader.value else -np.inf
        high = reader.number("high") if "high" in reader.value else np.inf
        if name == UNIFORM:
            reader.no_more("number", "distribution", "low", "high")
            low, high = reader.number("low"), reader.number("high")
            _require(low < high, reader, "low must be below high")
            return Marginal(reader.value, stats.uniform(low, high - low), low, high)
        kind = getattr(stats, name)
        shapes = [s.strip() for s in (kind.shapes or "").split(",") if s.strip()]
        reader.no_more("number", "distribution", "low", "high", "loc", "scale", *shapes)
        arguments = {shape: reader.number(shape) for shape in shapes}
        loc = reader.number("loc", default=0.0)
        frozen = kind(**arguments, loc=loc, scale=reader.number("scale", above=0.0, default=1.0))
        _require(np.isfinite(frozen.ppf(0.5)), reader, f"scipy.stats.{name} takes no such shapes")
        _require(frozen.cdf(high) > frozen.cdf(low), reader, "nothing lies between low and high")
        return Marginal(reader.value, frozen, low, high)

    @cached_property
    def _kept(self) -> tuple[float, float]:
        """The probabilities below the cuts."""
        return float(self.frozen.cdf(self.low)), float(self.frozen.cdf(self.high))

    def draw(self, rng: np.random.Generator) -> float:
        """One value."""
        if self._kept == (0.0, 1.0):
            return float(self.frozen.rvs(random_state=rng))
        return self.quantile(float(rng.uniform()))

    def quantile(self, probability: float) -> float:
        """The value below which a share of the draws lies."""
        below, above = self._kept
        return float(self.frozen.ppf(below + probability * (above - below)))

    def box(self, mass: float) -> tuple[float, float]:
        """The interval in which draws lie: all of them where it is bounded, else a central share
        `mass`."""
        low, high = self.quantile(0.0), self.quantile(1.0)
        tail = (1.0 - mass) / 2.0
        return (
            low if np.isfinite(low) else self.quantile(tail),
            high if np.isfinite(high) else self.quantile(1.0 - tail),
        )


def _require(holds: bool | np.bool_, reader: Reader, message: str) -> None:
    if not holds:
        raise BadRandomisation(f"{reader.path}: {message}", field=reader.path)
