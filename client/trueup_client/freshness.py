"""Freshness: a robot's own look at how old its observations are, and how long ago the service last
confirmed its model.

A controller that plans on what is too old must not: hold the two ages against their timeouts in
every tick, and command what is safe when either has passed. Nothing here waits, and nothing asks
the network.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Ages:
    """How old both are now [s]; infinite before the first. `stale` names what has passed its
    timeout."""

    observation_s: float
    model_s: float
    stale: tuple[str, ...]

    @property
    def fresh(self) -> bool:
        """Whether the controller may act on them."""
        return not self.stale


class Freshness:
    """Told of every observation and of every answer of the service, it says at any time whether
    both are young enough.

    A service that is away leaves the model ageing: how long a robot may go on without it is
    `model_timeout_s` [s], and its owner's choice. `clock` gives seconds that only grow.
    """

    def __init__(
        self,
        observation_timeout_s: float,
        model_timeout_s: float,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        if not (observation_timeout_s > 0.0 and model_timeout_s > 0.0):
            raise ValueError("timeouts must be positive")
        self._timeouts = {"observation": observation_timeout_s, "model": model_timeout_s}
        self._last = {"observation": float("-inf"), "model": float("-inf")}
        self._clock = clock

    def observed(self, age_s: float = 0.0) -> None:
        """An observation came, that was `age_s` [s] old already."""
        self._last["observation"] = max(self._last["observation"], self._clock() - age_s)

    def confirmed(self) -> None:
        """The service has said what serves: hand it to `Client.watch` as `confirmed`."""
        self._last["model"] = self._clock()

    def ages(self) -> Ages:
        """Both ages now, and what is stale."""
        now = self._clock()
        ages = {name: now - last for name, last in self._last.items()}
        stale = tuple(name for name, age in ages.items() if not age <= self._timeouts[name])
        return Ages(ages["observation"], ages["model"], stale)
