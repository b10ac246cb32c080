"""The closed loop: a planner issues commands, the plant applies them, and the controller sees the
state late."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueup.control.estimator import Estimator
from trueup.control.planner import Planner
from trueup.model.plant import Plant

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class LoopRun:
    """States `(ticks + 1, states)` and issued commands `(ticks, commands)` of one closed-loop
    run."""

    states: Array
    issued: Array

    def tracking_error(self, reference: Array, scale: Array | float = 1.0) -> float:
        """Mean squared distance of the positions after each tick from the reference `(ticks,
        joints)` then, in squares of a scale."""
        return float(np.mean(((self.states[1:, : reference.shape[1]] - reference) / scale) ** 2))

    def breaches(self, plant: Plant) -> float:
        """Share of the states outside the declared envelope."""
        outside = np.zeros(len(self.states), bool)
        for channel, values in zip(
            plant.layout.observations, plant.observe(self.states).T, strict=True
        ):
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
    planner: Planner,
    reference: Array,
    rng: np.random.Generator,
    delays: Sequence[int] = (0,),
    estimator: Estimator | None = None,
) -> LoopRun:
    """Run from rest. At tick t the controller sees the state of tick max(0, t - delay) [ticks];
    `delays` is one delay, or several that are used in turn.

    An `estimator` gets each observed state with its time, and each issued command, and estimates
    the state to plan from.
    """
    period = deployed.plant.timestep_s
    states = np.zeros((len(reference) + 1, 2 * deployed.plant.dynamics.joints))
    issued = np.zeros((len(reference), len(deployed.plant.layout.commands)))
    for t in range(len(reference)):
        seen_at = max(0, t - delays[t % len(delays)])
        seen = states[seen_at]
        if estimator is not None:
            estimator.observed(seen_at * period, seen)
            seen = estimator.state(t * period)
        issued[t] = planner.plan(seen, reference[t:], rng)
        if estimator is not None:
            estimator.commanded(t * period, issued[t])
        states[t + 1] = deployed.update(states[t], issued[t])
    return LoopRun(states, issued)
