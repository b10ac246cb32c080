"""One step of a simulator with what acts at its joint, for all lanes at once.

Forces are worked out at a part `alpha` of the step, its beginning or its middle, where the
simulator alone would be, and handed to it for the whole step. Dry friction is the force that slows
the joint and never turns it: the step is taken without it and with the whole of it, and where that
would turn the motion, in the proportion that stops it. A unit of an effect's force is an
acceleration of the joint at rest with its nominal parameters (`size`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trueup.model.simulator import MOTION, Simulator
from trueup.model.timeline import Acting

Array = NDArray[np.float64]
Memory = dict[tuple[str, str], Array]  # hidden states by effect and name, `(lanes,)`
NOMINAL_PARTS = {"passive", "drive", "spring"}


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedStep:
    """A simulator with its parameters `(lanes,)` by name, and the effects at its joint. `size` is
    the force that gives the joint at rest a unit of acceleration."""

    simulator: Simulator
    parameters: Mapping[str, Array]
    forces: Sequence[Acting]
    frictions: Sequence[Acting]
    size: float
    alpha: float
    u_scale: float
    period_s: float

    def at(self, lanes: Any) -> SimulatedStep:
        """The step of some of the lanes."""
        return SimulatedStep(
            self.simulator,
            {name: x[lanes] for name, x in self.parameters.items()},
            [one.at(lanes) for one in self.forces],
            [one.at(lanes) for one in self.frictions],
            self.size,
            self.alpha,
            self.u_scale,
            self.period_s,
        )

    @property
    def acts(self) -> bool:
        """Whether anything acts at the joint."""
        return bool(self.forces or self.frictions)

    def advance(
        self, state: Array, u: Array, h_s: Array, t_s: Any, memory: Memory, push: Any = 0.0
    ) -> tuple[Array, Memory]:
        """States `(lanes, states)` and memory a step of `h_s` [s] `(lanes,)` later, under commands
        `(lanes,)` and a `push`, an acceleration that nothing explains."""
        simulator = self.simulator
        exact = bool((h_s == simulator.timestep_s).all())
        h = None if exact else h_s
        if not self.acts:
            after = simulator.moved(state, u, self.parameters, h)
            return (after if np.isscalar(push) else _pushed(after, h_s, push)), memory
        free = simulator.moved(state, u, self.parameters, h)
        signals = self._signals(state, free, u, h_s, t_s, h)
        before, memory = signals["a"], dict(memory)
        for one in self.forces:
            signals["a"], *states = one.value(signals, memory)
            memory.update(zip(((one.effect.name, x) for x in one.effect.states), states))  # noqa: B905
        more = (signals["a"] - before + push) * self.size
        if not self.frictions:
            return simulator.moved(state, u, self.parameters, h, more), memory
        level: Any = 0.0
        for one in self.frictions:
            level = level + one.value(signals, memory)[0]
        if self.forces or not np.isscalar(push):
            free = simulator.moved(state, u, self.parameters, h, more)
        against = -np.copysign(level * self.size, free[:, 1])
        held = simulator.moved(state, u, self.parameters, h, more + against)
        slowed = free[:, 1] - held[:, 1]
        with np.errstate(divide="ignore", invalid="ignore"):
            share = np.where(slowed != 0.0, np.clip(free[:, 1] / slowed, 0.0, 1.0), 1.0)
        return free + share[:, None] * (held - free), memory

    def _signals(
        self, state: Array, free: Array, u: Array, h_s: Array, t_s: Any, h: Array | None
    ) -> dict[str, Any]:
        """What effects at the joint may ask for."""
        at = state[:, :MOTION] + self.alpha * (free[:, :MOTION] - state[:, :MOTION])
        signals: dict[str, Any] = {
            "q": at[:, 0],
            "v": at[:, 1],
            "a": (free[:, 1] - state[:, 1]) / h_s,
            "u": u,
            "h": h_s,
            "t": t_s,
            "implicit": 1.0 - 2.0 * self.alpha,
            "u_scale": self.u_scale,
            "period": self.period_s,
        }
        asked = {x for one in (*self.forces, *self.frictions) for x in one.effect.arguments()}
        if asked & NOMINAL_PARTS:
            there = state.copy()
            there[:, :MOTION] = at
            signals["passive"] = self._undriven(there, h_s, h)
            signals["drive"] = signals["a"] - signals["passive"]
            there[:, 1] = 0.0
            signals["spring"] = self._undriven(there, h_s, h)
        if "mobility" in asked:
            unit = np.full(len(u), self.size)
            pushed = self.simulator.moved(state, u, self.parameters, h, unit)
            signals["mobility"] = (pushed[:, 1] - free[:, 1]) / h_s
        return signals

    def _undriven(self, there: Array, h_s: Array, h: Array | None) -> Array:
        """The mean acceleration without a command over a step of which a state is the part `alpha`,
        `(lanes,)`."""
        none = np.zeros(len(there))
        begin = there
        if self.alpha:
            passes = self.simulator.moved(there, none, self.parameters, h) - there
            begin = there - self.alpha * passes
        after = self.simulator.moved(begin, none, self.parameters, h)
        return np.asarray((after[:, 1] - begin[:, 1]) / h_s)


def _pushed(state: Array, h_s: Array, push: Array) -> Array:
    """States that an acceleration moved during a step."""
    moved = state.copy()
    moved[:, 0] += 0.5 * h_s * h_s * push
    moved[:, 1] += h_s * push
    return moved
