"""One step of a simulator with what acts at its joints, for all lanes at once.

Forces are worked out at a part `alpha` of the step, its beginning or its middle, where the
simulator alone would be, and handed to it for the whole step. Dry friction is the force that slows
a joint and never turns it: the step is taken without it and with the whole of it at each joint that
rubs, and of each so much is taken that no joint is turned. A unit of an effect's force is an
acceleration of its joint at rest with the nominal parameters (`sizes`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trueup.model.joint_effects import PARTS, answers_all
from trueup.model.simulator.simulator import Simulator
from trueup.model.simulator.timeline import Acting
from trueup.model.tree import SWEEPS

Array = NDArray[np.float64]
Memory = dict[tuple[str, str], Array]  # hidden states by term and name, `(lanes,)`
Signals = dict[str, Any]  # of one joint, by name


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedStep:
    """A simulator with its parameters `(lanes,)` by name, and the effects at its joints. `sizes`
    `(joints,)` is the force that gives each joint at rest a unit of acceleration, `u_scale`
    `(joints,)` its command's declared limit, `period_s` `(lanes,)` the log's, `asked` what the
    effects ask for."""

    simulator: Simulator
    parameters: Mapping[str, Array]
    forces: Sequence[Acting]
    frictions: Sequence[Acting]
    sizes: Array
    alpha: float
    u_scale: Array
    period_s: Array
    asked: frozenset[str]

    def at(self, lanes: Any) -> SimulatedStep:
        """The step of some of the lanes."""
        return replace(
            self,
            parameters={name: x[lanes] for name, x in self.parameters.items()},
            forces=[one.at(lanes) for one in self.forces],
            frictions=[one.at(lanes) for one in self.frictions],
            period_s=self.period_s[lanes],
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
            period_s=np.concatenate([s.period_s for s in steps]),
        )

    @property
    def acts(self) -> bool:
        """Whether anything acts at the joints."""
        return bool(self.forces or self.frictions)

    def advance(
        self,
        state: Array,
        u: Array,
        h_s: Array,
        t_s: Any,
        memory: Memory,
        push: Array | None = None,
    ) -> tuple[Array, Memory]:
        """States `(lanes, states)` and memory a step of `h_s` [s] `(lanes,)` later, under commands
        `(lanes, joints)` and a `push`, accelerations that nothing explains, `(lanes, joints)`."""
        if not self.acts:
            return self._undisturbed(state, u, h_s, push), memory
        free = self._moved(state, u, h_s)
        inverse_mass = self._inverse_mass(state, free, u, h_s) if self.asked & PARTS else None
        signals = self._signals(state, free, u, h_s, t_s, inverse_mass)
        memory = dict(memory)
        gained = self._pushed(signals, memory, inverse_mass)
        more = (gained if push is None else gained + push) * self.sizes
        if not self.frictions:
            return self._moved(state, u, h_s, more), memory
        if self.forces or push is not None:
            free = self._moved(state, u, h_s, more)
        level = np.zeros_like(u)
        for one in self.frictions:
            level[:, one.joint] += one.value(signals[one.joint], memory)[0]
        return self._braked(state, u, h_s, more, free, level * self.sizes), memory

    def _pushed(
        self, signals: Sequence[Signals], memory: Memory, inverse_mass: Array | None
    ) -> Array:
        """What forces change in the accelerations `(lanes, joints)`; those that answer all others
        come last."""
        gained = np.zeros((len(signals[0]["u"]), len(signals)))

        def act(one: Acting) -> None:
            now = signals[one.joint]
            after, *states = one.value(now, memory)
            gained[:, one.joint] += after - now["a"]
            now["a"] = after
            memory.update(zip(one.keys, states, strict=True))

        answering = [one for one in self.forces if answers_all(one.effect)]
        for one in self.forces:
            if one not in answering:
                act(one)
        if answering and len(signals) > 1:
            assert inverse_mass is not None
            elsewhere = inverse_mass * (1.0 - np.eye(len(signals)))
            through = np.einsum("ljk,lk->lj", elsewhere, gained * self.sizes)
            for j, now in enumerate(signals):
                now["passive"] = now["passive"] + through[:, j] / now["mobility"]
        for one in answering:
            act(one)
        return gained

    def _braked(
        self, state: Array, u: Array, h_s: Array, more: Array, free: Array, level: Array
    ) -> Array:
        """States after dry friction up to a level `(lanes, joints)` at each joint. Source: J. J.
        Moreau (1988); the sweeps: M. Jean, Computer Methods in Applied Mechanics and Engineering
        177 (1999)."""
        joints = level.shape[1]
        rubs = sorted({one.joint for one in self.frictions})
        velocities = slice(joints, 2 * joints)
        v, changes, shares = free[:, velocities].copy(), {}, dict.fromkeys(rubs, np.zeros(len(u)))
        for j in rubs:
            held = more.copy()
            held[:, j] -= np.copysign(level[:, j], v[:, j])
            changes[j] = self._moved(state, u, h_s, held) - free
        for _ in range(SWEEPS if len(rubs) > 1 else 1):
            for j in rubs:
                slows = changes[j][:, joints + j]
                wanted = np.clip(shares[j] - v[:, j] / slows, -1.0, 1.0)
                wanted = np.where(slows != 0.0, wanted, 1.0)
                v += (wanted - shares[j])[:, None] * changes[j][:, velocities]
                shares[j] = wanted
        return np.asarray(free + sum(shares[j][:, None] * changes[j] for j in rubs))

    def _signals(
        self,
        state: Array,
        free: Array,
        u: Array,
        h_s: Array,
        t_s: Any,
        inverse_mass: Array | None,
    ) -> list[Signals]:
        """What effects at each joint may ask for."""
        joints, motion = self.simulator.joints, self.simulator.motion
        there = state.copy()
        there[:, :motion] += self.alpha * (free - state)[:, :motion]
        a = self._gained(state, free, h_s)
        signals: list[Signals] = [
            {
                "q": there[:, j],
                "v": there[:, joints + j],
                "a": a[:, j],
                "u": u[:, j],
                "h": h_s,
                "t": t_s,
                "implicit": 1.0 - 2.0 * self.alpha,
                "u_scale": float(self.u_scale[j]),
                "period": self.period_s,
            }
            for j in range(joints)
        ]
        if inverse_mass is not None:
            mobility = np.einsum("ljj->lj", inverse_mass) * self.sizes
            drive = self._as_forces(inverse_mass, a - self._undriven(there, h_s))
            for j, now in enumerate(signals):
                now |= {
                    "mobility": mobility[:, j],
                    "drive": drive[:, j],
                    "passive": a[:, j] / mobility[:, j] - drive[:, j],
                }
                if "spring" in self.asked:
                    at_rest = there.copy()
                    at_rest[:, joints + j] = 0.0
                    springs = self._as_forces(inverse_mass, self._undriven(at_rest, h_s))
                    now["spring"] = springs[:, j]
        return signals

    def _inverse_mass(self, state: Array, free: Array, u: Array, h_s: Array) -> Array:
        """The acceleration of each joint by a unit of force at each, `(lanes, joints, joints)`."""
        columns = []
        for j, size in enumerate(self.sizes):
            force = np.zeros_like(u)
            force[:, j] = size
            columns.append(self._gained(free, self._moved(state, u, h_s, force), h_s) / size)
        return np.stack(columns, axis=2)

    def _as_forces(self, inverse_mass: Array, accelerations: Array) -> Array:
        """The forces that bring about accelerations, in units of the effects', `(lanes, joints)`
        each."""
        if len(self.sizes) == 1:
            return np.asarray(accelerations / (inverse_mass[:, 0] * self.sizes))
        try:
            forces = np.linalg.solve(inverse_mass, accelerations[..., None])
        except np.linalg.LinAlgError:  # no force moves a lane that has run away
            moves = (np.linalg.det(inverse_mass) != 0.0)[:, None, None]
            forces = np.linalg.solve(
                np.where(moves, inverse_mass, np.nan), accelerations[..., None]
            )
        return np.asarray(forces[..., 0] / self.sizes)

    def _gained(self, before: Array, after: Array, h_s: Array) -> Array:
        """The mean acceleration between states, `(lanes, joints)`."""
        velocities = slice(self.simulator.joints, self.simulator.motion)
        return np.asarray((after - before)[:, velocities] / h_s[:, None])

    def _moved(self, state: Array, u: Array, h_s: Array, force: Array | None = None) -> Array:
        return self.simulator.moved(state, u, self.parameters, h_s, force)

    def _undriven(self, there: Array, h_s: Array) -> Array:
        """The mean accelerations without commands over a step of which a state is the part `alpha`,
        `(lanes, joints)`."""
        none = np.zeros((len(there), self.simulator.joints))
        begin = there
        if self.alpha:
            passes = self._moved(there, none, h_s) - there
            begin = there - self.alpha * passes
        return self._gained(begin, self._moved(begin, none, h_s), h_s)

    def _undisturbed(self, state: Array, u: Array, h_s: Array, push: Array | None) -> Array:
        """States a step later where nothing acts but a push: of several joints as forces, where the
        simulator takes them, for a force at one moves the others, too."""
        if push is not None and self.simulator.joints > 1 and self.simulator.takes_force:
            return self._moved(state, u, h_s, push * self.sizes)
        moved = self._moved(state, u, h_s)
        if push is None:
            return moved
        joints, moved, span = self.simulator.joints, moved.copy(), h_s[:, None]
        moved[:, :joints] += 0.5 * span * span * push
        moved[:, joints : 2 * joints] += span * push
        return moved
