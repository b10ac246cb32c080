"""Estimator: the current state from observations that come late, irregularly and out of order, and
from the commands known to act until then.

The last observation, by its own stamp and not by its arrival, is rolled forward through the
commands that act since, in steps of the predictor and a last shorter one. So a late sensor costs
the model's error over a few steps, and not the delay. Source: O. J. M. Smith, Chemical Engineering
Progress 53 (1957), on controlling across a known delay by predicting over it.
"""

from __future__ import annotations

from bisect import bisect_right, insort
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from trueup.errors import NotIdentifiable
from trueup.model.block import joint, kind
from trueup.model.corrected import Corrected
from trueup.model.predictor import Predictor

Array = NDArray[np.float64]
DELAYS = ("actuator_delay", "sensor_delay")  # one law on a log's own clock
WHOLE = 1e-6  # of a step: stamps that far from a whole number of steps are on it


@dataclass
class Estimator:
    """Feed it what was observed and what was commanded, each with the time for which it holds; ask
    it for the state at any later time.

    A command acts from its time until the next one's; what was before the first is taken to be the
    first. Observations are states: what a model's effects remember beyond them (a lag, play, heat)
    begins anew where it is rolled on from.
    """

    predictor: Predictor
    _stamp_s: float = -np.inf
    _seen: Array | None = None
    _times_s: list[float] = field(default_factory=list)
    _commands: dict[float, Array] = field(default_factory=dict)

    def observed(self, at_s: float, state: Array) -> bool:
        """Take in a state `(states,)` observed at a time [s]. Returns False, and changes nothing,
        if a later one is known or it is not all finite."""
        if at_s < self._stamp_s or not np.isfinite(state).all():
            return False
        self._stamp_s, self._seen = at_s, np.array(state, float)
        self._forget()
        return True

    def commanded(self, from_s: float, issued: Array) -> None:
        """Take in a command `(commands,)` that acts from a time [s] on: its issue, and the drive's
        own delay."""
        if from_s not in self._commands:
            insort(self._times_s, from_s)
        self._commands[from_s] = np.array(issued, float)

    def state(self, at_s: float) -> Array:
        """The state `(states,)` at a time [s], or at the last observation's if that is later.
        Raises NotIdentifiable before any observation."""
        if self._seen is None:
            raise NotIdentifiable(
                "nothing has been observed yet",
                hint="Feed the estimator an observation before it is asked.",
            )
        state, now = self._seen[None, :], self._stamp_s
        while at_s - now > WHOLE * self._step:
            i = bisect_right(self._times_s, now + WHOLE * self._step)
            until = min(at_s, self._times_s[i]) if i < len(self._times_s) else at_s
            state, now = self._rolled(state, self._acting(i), until - now), until
        return np.asarray(state[0])

    @property
    def _step(self) -> float:
        return self.predictor.plant.timestep_s

    def _acting(self, after: int) -> Array:
        """The command before the one with this index."""
        if not self._times_s:
            return np.zeros((1, len(self.predictor.plant.layout.commands)))
        return self._commands[self._times_s[max(after - 1, 0)]][None, :]

    def _rolled(self, state: Array, issued: Array, seconds: float) -> Array:
        """The state `(1, states)` after a while under one command."""
        steps = int(seconds / self._step + WHOLE)
        if steps:
            state = self.predictor.hold(state, issued, steps)[:, -1]
        rest = seconds - steps * self._step
        return (
            self.predictor.predict_batch(state, issued, rest)
            if rest > WHOLE * self._step
            else state
        )

    def _forget(self) -> None:
        """Drop commands that ended before what was observed."""
        ended = max(bisect_right(self._times_s, self._stamp_s) - 1, 0)
        for at_s in self._times_s[:ended]:
            del self._commands[at_s]
        del self._times_s[:ended]


def transport_delay_s(predictor: Predictor) -> float:
    """The delay [s] between a command's issue and its effect in the observations, according to a
    predictor: the delays of drive and sensor that all joints share."""
    if not isinstance(predictor, Corrected):
        return 0.0
    delays = [0.0] * len(predictor.plant.joints)
    for term in predictor.hypothesis.effects:
        if kind(term).name in DELAYS:
            delays[joint(term)] += predictor.values[predictor.plant.block.rows_of(term)["delay"]]
    return min(delays)
