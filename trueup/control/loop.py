"""The closed loop: a planner issues, the plant applies, the controller sees the state late."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueup.control.estimator import Estimator
from trueup.control.planner import RandomShooting
from trueup.model.plant import Plant

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Run:
    """States `(ticks + 1, states)` and issued commands `(ticks, commands)` of one closed-loop run."""

    states: Array
    issued: Array

    def tracking_error(self, reference: Array) -> float:
        """Mean squared distance of the position after each tick from the reference at that tick."""
        return float(np.mean((self.states[1:, 0] - reference) ** 2))

    def breaches(self, plant: Plant) -> float:
        """Share of the states outside the declared envelope."""
        outside = np.zeros(len(self.states), bool)
        for channel, values in zip(plant.layout.observations, plant.observe(self.states).T, strict=True):
            low, high = plant.envelope.get(channel.name, (-np.inf, np.inf))
            outside |= (values < low) | (values > high)
        return float(outside.mean())


@dataclass(frozen=True, slots=True)
class Deployed:
    """The machine under control: the plant's form with its true parameters and actuator limit."""

    plant: Plant
    parameters: Sequence[float]
    u_max: float

    def update(self, state: Array, issued: Array) -> Array:
        """Next state `(states,)`."""
        limited = np.clip(issued, -self.u_max, self.u_max)
        return np.asarray(self.plant.update(state[None, :], limited[None, :], self.parameters)[0])


def run_loop(
    deployed: Deployed,
    planner: RandomShooting,
    reference: Array,
    rng: np.random.Generator,
    delays: Sequence[int] = (0,),
    estimator: Estimator | None = None,
) -> Run:
    """Run from rest; at tick t the controller sees the state of tick max(0, t - delay) [ticks], one delay or, in turn, several.

    An `estimator` is told what is seen, when it was and what is issued, and is asked for the state to plan from.
    """
    period = deployed.plant.timestep_s
    states = np.zeros((len(reference) + 1, 2 * deployed.plant.dynamics.joints))
    issued = np.zeros((len(reference), 1))
    for t, target in enumerate(reference):
        seen_at = max(0, t - delays[t % len(delays)])
        seen = states[seen_at]
        if estimator is not None:
            estimator.observed(seen_at * period, seen)
            seen = estimator.state(t * period)
        issued[t] = planner.plan(seen, float(target), rng)
        if estimator is not None:
            estimator.commanded(t * period, issued[t])
        states[t + 1] = deployed.update(states[t], issued[t])
    return Run(states, issued)
