"""How old a robot's observations are, and how long ago the service last confirmed its model.

A controller must not plan on what is too old. It compares the two ages with their timeouts in every
tick, and commands what is safe when either has passed. Nothing here waits or asks the network.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Ages:
    """The age of the last observation and of the last confirmation of the model [s].

    An age is infinite before the first. `stale` names what has passed its timeout.
    """

    observation_s: float
    model_s: float
    stale: tuple[str, ...]

    @property
    def fresh(self) -> bool:
        """Whether the controller may act on them."""
        return not self.stale


class Freshness:
    """Records each observation and each answer of the service, and says whether both are fresh.

    While the service is away the model ages. How long a robot may go on without it is
    `model_timeout_s` [s], its owner's choice. `clock` returns seconds that never decrease. Raises
    ValueError if a timeout is not positive.
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
        """Records an observation that is `age_s` [s] old."""
        self._last["observation"] = max(self._last["observation"], self._clock() - age_s)

    def confirmed(self) -> None:
        """Records an answer of the service. Pass it to `Client.watch` as `confirmed`."""
        self._last["model"] = self._clock()

    def ages(self) -> Ages:
        """Returns both ages now, and what is stale."""
        now = self._clock()
        ages = {name: now - last for name, last in self._last.items()}
        stale = tuple(name for name, age in ages.items() if not age <= self._timeouts[name])
        return Ages(ages["observation"], ages["model"], stale)
