"""The closed loop: a planner issues commands, the machine applies them, and the controller sees the
state late."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueup.control.delay import seen_at
from trueup.control.estimator import Estimator, transport_delay_s
from trueup.control.machine import Machine
from trueup.control.planner import Planner
from trueup.model.plant import Plant

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class LoopRun:
    """One closed-loop run: states `(ticks + 1, states)`, the commands that the controller `issued`
    and what the actuators' limits left of them, `applied`, `(ticks, commands)` each."""

    states: Array
    issued: Array
    applied: Array

    def tracking_error(self, reference: Array, scale: Array | float = 1.0) -> float:
        """Mean squared distance of the positions after each tick from the reference `(ticks,
        joints)` then, in squares of a scale."""
        with np.errstate(over="ignore", invalid="ignore"):  # a run that ran away gives inf or nan
            missed = (self.states[1:, : reference.shape[1]] - reference) / scale
            return float(np.mean(missed**2))

    def breaches(self, plant: Plant) -> float:
        """Share of the states outside the declared envelope."""
        outside = np.zeros(len(self.states), bool)
        for channel, values in zip(
            plant.layout.observations, plant.observe(self.states).T, strict=True
        ):
            low, high = plant.envelope.get(channel.name, (-np.inf, np.inf))
            outside |= (values < low) | (values > high)
        return float(outside.mean())


def run_loop(
    machine: Machine,
    planner: Planner,
    reference: Array,
    rng: np.random.Generator,
    *,
    begin: Array | None = None,
    hold: int = 1,
    delays: Sequence[int] = (0,),
    stamped: bool = False,
) -> LoopRun:
    """Run from `begin` `(states,)`, else from rest at zero, with a tick of `hold` steps, along a
    reference `(ticks, joints)`.

    At tick t the controller sees the state of tick max(0, t - delay); `delays` [ticks] is one
    delay, or several that are used in turn. A `stamped` observation says how old it is, and is
    rolled forward through the commands issued since; any other is taken for what is now. A delay
    that the planner's own model has is planned over in both cases.
    """
    plant, ticks = machine.plant, len(reference)
    states = np.zeros((ticks + 1, 2 * plant.dynamics.joints))
    if begin is not None:
        states[0] = begin
    issued = np.zeros((ticks, len(plant.layout.commands)))
    estimator, late_s = Estimator(planner.predictor), transport_delay_s(planner.predictor)
    t_s = np.arange(ticks) * hold * plant.timestep_s
    # what is commanded now shows at the reference that is due then
    shows = np.arange(ticks) + late_s / (hold * plant.timestep_s)
    aims = np.stack([np.interp(shows, np.arange(ticks), r) for r in reference.T], axis=1)
    with np.errstate(over="ignore", invalid="ignore"):  # a loop that runs away ends as inf
        for t in range(ticks):
            seen = seen_at(t, delays[t % len(delays)])
            estimator.observed(float(t_s[seen if stamped else t]), states[seen])
            issued[t] = planner.plan(estimator.state(t_s[t] + late_s), aims[t:], rng)
            estimator.commanded(t_s[t] + late_s, issued[t])
            states[t + 1] = machine.after(states[: t + 1], issued[: t + 1], hold)
    return LoopRun(states, issued, machine.applied(issued))
