"""Candidate: a fitted composition of effects, with how it does on validation episodes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueup.fit.rollout_fit import RolloutFit
from trueup.model.hypothesis import Hypothesis


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """A composition fitted to adaptation episodes, and checked on validation episodes, where
    nothing but the windows' starts is estimated.

    Not `resolved` is one with an effect so small that it stands for integration's own errors.
    `others` are minima that the data do not tell from the fit's, where it was taken to one.
    """

    fit: RolloutFit
    check: RolloutFit
    resolved: bool = True
    others: tuple[RolloutFit, ...] = ()

    @property
    def minima(self) -> tuple[RolloutFit, ...]:
        """Every minimum, its own the first."""
        return self.fit, *self.others

    @property
    def costs(self) -> NDArray[np.float64]:
        """Cost of every window, those that were fitted first, `(windows,)`."""
        return np.concatenate([self.fit.costs, self.check.costs])

    @property
    def hypothesis(self) -> Hypothesis:
        """What acts."""
        return self.fit.hypothesis

    @property
    def reduced_chi_square(self) -> float:
        """Mean squared normalised error on validation episodes."""
        return self.check.reduced_chi_square

    @property
    def total(self) -> float:
        """Mean squared normalised error over adaptation and validation episodes together."""
        return (self.fit.cost + self.check.cost) / (self.fit.samples + self.check.samples)
