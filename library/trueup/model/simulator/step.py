"""One step of a simulator with what acts at its joint, for all lanes at once.

Forces are worked out at a part `alpha` of the step, its beginning or its middle, where the
simulator alone would be, and handed to it for the whole step. Dry friction is the force that slows
the joint and never turns it: the step is taken without it and with the whole of it, and where that
would turn the motion, in the proportion that stops it. A unit of an effect's force is an
acceleration of the joint at rest with its nominal parameters (`size`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trueup.model.simulator.simulator import MOTION, Simulator
from trueup.model.simulator.timeline import Acting

Array = NDArray[np.float64]
Memory = dict[tuple[str, str], Array]  # hidden states by effect and name, `(lanes,)`
NOMINAL_PARTS = {"passive", "drive", "spring"}


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedStep:
    """A simulator with its parameters `(lanes,)` by name, and the effects at its joint. `size` is
    the force that gives the joint at rest a unit of acceleration, `asked` what the effects ask
    for."""

    simulator: Simulator
    parameters: Mapping[str, Array]
    forces: Sequence[Acting]
    frictions: Sequence[Acting]
    size: float
    alpha: float
    u_scale: float
    period_s: float
    asked: frozenset[str]

    def at(self, lanes: Any) -> SimulatedStep:
        """The step of some of the lanes."""
        return replace(
            self,
            parameters={name: x[lanes] for name, x in self.parameters.items()},
            forces=[one.at(lanes) for one in self.forces],
            frictions=[one.at(lanes) for one in self.frictions],
        )

    @staticmethod
    def side_by_side(steps: Sequence[SimulatedStep]) -> SimulatedStep:
        """One step in the lanes of several."""
        names = steps[0].parameters
        return replace(
            steps[0],
            parameters={n: np.concatenate([s.parameters[n] for s in steps]) for n in names},
            forces=[Acting.side_by_side(x) for x in zip(*(s.forces for s in steps), strict=True)],
            frictions=[
                Acting.side_by_side(x) for x in zip(*(s.frictions for s in steps), strict=True)
            ],
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
        free = self._moved(state, u, h_s)
        if not self.acts:
            return (free if np.isscalar(push) else _pushed(free, h_s, push)), memory
        signals = self._signals(state, free, u, h_s, t_s)
        before, memory = signals["a"], dict(memory)
        for one in self.forces:
            signals["a"], *states = one.value(signals, memory)
            keys = ((one.effect.name, state) for state in one.effect.states)
            memory.update(zip(keys, states, strict=True))
        more = (signals["a"] - before + push) * self.size
        if not self.frictions:
            return self._moved(state, u, h_s, more), memory
        level: Any = 0.0
        for one in self.frictions:
            level = level + one.value(signals, memory)[0]
        if self.forces or not np.isscalar(push):
            free = self._moved(state, u, h_s, more)
        against = -np.copysign(level * self.size, free[:, 1])
        held = self._moved(state, u, h_s, more + against)
        slowed = free[:, 1] - held[:, 1]
        with np.errstate(divide="ignore", invalid="ignore"):
            share = np.where(slowed != 0.0, np.clip(free[:, 1] / slowed, 0.0, 1.0), 1.0)
        return free + share[:, None] * (held - free), memory

    def _signals(self, state: Array, free: Array, u: Array, h_s: Array, t_s: Any) -> dict[str, Any]:
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
        if self.asked & NOMINAL_PARTS:
            there = state.copy()
            there[:, :MOTION] = at
            signals["passive"] = self._undriven(there, h_s)
            signals["drive"] = signals["a"] - signals["passive"]
            there[:, 1] = 0.0
            signals["spring"] = self._undriven(there, h_s)
        if "mobility" in self.asked:
            unit = np.full(len(u), self.size)
            pushed = self._moved(state, u, h_s, unit)
            signals["mobility"] = (pushed[:, 1] - free[:, 1]) / h_s
        return signals

    def _moved(self, state: Array, u: Array, h_s: Array, force: Array | None = None) -> Array:
        return self.simulator.moved(state, u, self.parameters, h_s, force)

    def _undriven(self, there: Array, h_s: Array) -> Array:
        """The mean acceleration without a command over a step of which a state is the part `alpha`,
        `(lanes,)`."""
        none = np.zeros(len(there))
        begin = there
        if self.alpha:
            passes = self._moved(there, none, h_s) - there
            begin = there - self.alpha * passes
        after = self._moved(begin, none, h_s)
        return np.asarray((after[:, 1] - begin[:, 1]) / h_s)


def _pushed(state: Array, h_s: Array, push: Array) -> Array:
    """States that an acceleration moved during a step."""
    moved = state.copy()
    moved[:, 0] += 0.5 * h_s * h_s * push
    moved[:, 1] += h_s * push
    return moved
