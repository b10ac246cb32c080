"""The dynamics of a simulator of the user's own, in numpy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from trueup.errors import BadSimulator
from trueup.model.block import Block
from trueup.model.dynamics import Dynamics, Form
from trueup.model.simulator.simulator import Simulator
from trueup.model.tree import TREE

Array = NDArray[np.float64]
NO_FORM = -2  # the number of what the compiled rollout cannot roll out
SLOPE = 1e-4  # of a parameter, or 1: the finite difference of an acceleration


@dataclass(frozen=True)
class SimulatedDynamics(Dynamics):
    """Joints that a user's step function moves."""

    simulator: Simulator
    name = "simulator"

    @property
    def joints(self) -> int:  # type: ignore[override]
        return self.simulator.joints

    @property
    def parameter_names(self) -> tuple[str, ...]:  # type: ignore[override]
        return tuple(self.simulator.parameters)

    @property
    def takes_force(self) -> bool:
        return self.simulator.takes_force

    def step(self, state: Array, applied: Array, parameters: Array, h_s: Array | float) -> Array:
        """State after `h_s` [s]; hidden states begin as declared."""
        hidden = np.tile(np.array(self.simulator.begins), (len(state), 1))
        span = np.broadcast_to(np.asarray(h_s, float), len(state))
        with_hidden = np.concatenate([state, hidden], axis=1)
        return self._moved(with_hidden, applied, parameters, span)[:, : self.simulator.motion]

    def rollout(
        self,
        parameters: Array,
        initial: Array,
        applied: Array,
        h_s: Array,
        steps: NDArray[np.int64],
    ) -> Array:
        vectors, (windows, samples) = len(parameters), applied.shape[:2]
        motion = self.simulator.motion
        out = np.empty((vectors, windows, samples, motion))
        numbers = np.repeat(parameters.T, windows, axis=1)
        hidden = np.tile(np.array(self.simulator.begins), (vectors * windows, 1))
        now = np.concatenate([np.tile(initial, (vectors, 1)), hidden], axis=1)
        for i in range(samples):
            out[:, :, i] = now[:, :motion].reshape(vectors, windows, motion)
            for step in range(int(steps[:, i].max(initial=0)) if i + 1 < samples else 0):
                runs = np.flatnonzero(np.tile(steps[:, i] > step, vectors))
                u = np.tile(applied[:, i], (vectors, 1))[runs]
                span = np.tile(h_s[:, i], vectors)[runs]
                with np.errstate(over="ignore", invalid="ignore"):  # running away is an answer
                    now[runs] = self._moved(now[runs], u, numbers[:, runs], span)
        return out

    def hold(
        self, parameters: Array, states: Array, applied: Array, h_s: float, steps: int
    ) -> Array:
        held = np.repeat(applied[:, None, :], steps + 1, axis=1)
        runs = np.ones(held.shape[:2], np.int64)
        return self.rollout(np.array([parameters]), states, held, np.full(runs.shape, h_s), runs)[
            0, :, 1:
        ]

    def acceleration(self, parameters: Array, states: Array, applied: Array) -> Array:
        """The mean accelerations `(n, joints)` over a step from states `(n, 2 x joints)` under
        commands `(n, joints)`."""
        velocities, h_s = slice(self.joints, 2 * self.joints), self.simulator.timestep_s
        after = self.step(states, applied, parameters, h_s)
        return np.asarray((after - states)[:, velocities] / h_s)

    def drive(self, parameters: Sequence[float], joint: int, q: Array, applied: Array) -> Array:
        numbers, states = np.array(parameters), np.zeros((len(q), 2 * self.joints))
        states[:, joint] = q
        command = np.zeros((len(q), self.joints))
        idle = self.acceleration(numbers, states, command)
        command[:, joint] = applied
        return np.asarray((self.acceleration(numbers, states, command) - idle)[:, joint])

    def neutral(self, parameters: Sequence[float], joint: int, q: Array) -> Array:
        return np.zeros(len(q))

    def inertia(self, parameters: Array, q: Array) -> Array:
        if self.joints == 1 or not self.takes_force:
            return np.tile(np.eye(self.joints), (len(q), 1, 1))
        return np.asarray(self.mass(parameters, q) / self.form.sizes[None, :, None])

    def own_regressors(self, states: Array, applied: Array) -> Array | None:
        """How the acceleration changes with each parameter, near the nominal ones."""
        if self.joints > 1:
            return None
        numbers = np.array(list(self.simulator.parameters.values()))
        return self.slopes(numbers, states, applied)[:, 0]

    def slopes(self, numbers: Array, states: Array, applied: Array) -> Array:
        """How the accelerations change with each of some parameters, `(n, joints, parameters)`."""
        columns = []
        for i, value in enumerate(numbers):
            by = SLOPE * (abs(value) or 1.0)
            ends = [
                self.acceleration(numbers + sign * by * np.eye(len(numbers))[i], states, applied)
                for sign in (1.0, -1.0)
            ]
            columns.append((ends[0] - ends[1]) / (2.0 * by))
        return np.stack(columns, axis=2)

    @property
    def has_own_numbers(self) -> bool:
        return self.joints == 1

    def without_dry_friction(self, parameters: Array) -> Array:
        return parameters

    @cached_property
    def form(self) -> Form:  # type: ignore[override]
        return Form(
            Block(len(self.simulator.parameters), self.joints),
            NO_FORM,
            np.zeros((self.joints, TREE)),
            self.sizes(list(self.simulator.parameters.values())),
            self.simulator,
        )

    def sizes(self, parameters: Sequence[float]) -> Array:
        """The force that gives each joint at rest, with some parameters and with nothing else in
        its way, a unit of acceleration, `(joints,)`; 1 where the simulator takes none. Raises
        BadSimulator."""
        if not self.simulator.takes_force:
            return np.ones(self.joints)
        mass = self.mass(np.array(parameters, float), np.zeros((1, self.joints)))[0]
        return np.diag(mass).copy()

    def mass(self, parameters: Array, q: Array) -> Array:
        """The mass matrices at rest at positions `(n, joints)`, `(n, joints, joints)`. Raises
        BadSimulator where a force does not move its joint its way."""
        simulator = self.simulator
        states = np.concatenate(
            [q, np.zeros_like(q), np.tile(np.array(simulator.begins), (len(q), 1))], axis=1
        )
        given = zip(simulator.parameters, parameters, strict=True)
        lanes = {name: np.full(len(q), float(x)) for name, x in given}
        velocities = slice(self.joints, 2 * self.joints)
        free, *pushed = (
            simulator.moved(states, np.zeros_like(q), lanes, None, np.tile(force, (len(q), 1)))
            for force in (np.zeros(self.joints), *np.eye(self.joints))
        )
        gained = np.stack([(after - free)[:, velocities] for after in pushed], axis=2)
        mobility = gained / simulator.timestep_s
        if not (np.einsum("njj->nj", mobility) > 0.0).all():
            raise BadSimulator(
                f"{simulator.name} takes a force that does not move the joint its way",
                hint="Add `force` where the simulator adds the forces of its drives.",
            )
        try:
            return np.asarray(np.linalg.inv(mobility))
        except np.linalg.LinAlgError as error:
            raise BadSimulator(
                f"{simulator.name} takes forces that move two joints as one",
                hint="Each column of `force` acts at a joint of its own.",
            ) from error

    def _moved(self, state: Array, u: Array, parameters: Array, h_s: Array) -> Array:
        simulator = self.simulator
        numbers = np.broadcast_to(
            parameters[:, None] if parameters.ndim == 1 else parameters,
            (len(simulator.parameters), len(state)),
        )
        lanes = dict(zip(simulator.parameters, numbers, strict=True))
        return simulator.moved(state, u, lanes, h_s)
