"""What a rollout fit ends in: the fitted numbers, where its windows start, and what it cost."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trueup.fit.free_numbers import Free
from trueup.model.hypothesis import Hypothesis

Array = NDArray[np.float64]
PROVEN = 0.01  # of a half-width: a fit so close to its minimum is at it
TWO_SIDED = 1.96  # standard errors of a 95 % interval


@dataclass(frozen=True, slots=True)
class Start:
    """Where an episode's rollouts start: each window's positions and velocities `(windows, 2 x
    joints)`, and the hidden states' offsets.

    `steps` `(windows, 2 x joints)` are for differences by the former, the fitter's own where None.
    """

    windows: Array
    memory: Mapping[tuple[str, str], float]
    steps: Array | None = None

    def moved(self, windows: Array, memory: Array, states: tuple[tuple[str, str], ...]) -> Start:
        """This start with its windows and the offsets of hidden `states` moved by steps."""
        past = dict(self.memory)
        for key, by in zip(states, memory, strict=True):
            past[key] = past.get(key, 0.0) + float(by)
        return replace(self, windows=self.windows + windows, memory=past)


@dataclass(frozen=True, slots=True)
class RolloutFit:
    """A fitted hypothesis.

    `values` is the block's parameter vector, `free` its free rows, `starts` where rollouts start,
    by episode digest. `cost` is the sum of squared normalised errors over `samples` numbers,
    `costs` that of each window; `information` `(free, free)` the reduced normal matrix and
    `scores` `(windows, free)` what each window adds to the gradient. `distance` is how far the
    minimum is, in half-widths of an interval, None where nobody looked.
    """

    hypothesis: Hypothesis
    values: Array
    free: Free
    starts: Mapping[str, Start]
    cost: float
    costs: Array
    samples: int
    information: Array
    converged: bool
    scores: Array
    distance: float | None = None

    @property
    def proven(self) -> bool:
        """Whether it was shown to be at a minimum."""
        return self.distance is not None and self.distance <= PROVEN

    @property
    def by_episode(self) -> dict[str, float]:
        """Cost of each episode, by digest."""
        return {key: float(costs.sum()) for key, costs in self.split(self.costs).items()}

    def split(self, of_windows: NDArray[Any]) -> dict[str, NDArray[Any]]:
        """Something of every window `(windows, …)`, by the digest of the window's episode."""
        ends = np.cumsum([len(s.windows) for s in self.starts.values()])
        return dict(zip(self.starts, np.split(of_windows, ends[:-1]), strict=True))

    @property
    def reduced_chi_square(self) -> float:
        """Mean squared normalised error: 1 where noise is all that is left."""
        return self.cost / self.samples

    def parameters(self, of: str = "") -> dict[str, float]:
        """Fitted parameters of one term, or of the nominal form."""
        return {
            name: float(x)
            for x, (owner, name) in zip(self.free.at(self.values), self.free.names, strict=True)
            if owner == of
        }
