"""The dynamics of a simulator of the user's own: one joint, in numpy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from trueup.errors import BadSimulator
from trueup.model.block import Block
from trueup.model.dynamics import Dynamics, Form
from trueup.model.simulator.simulator import MOTION, Simulator
from trueup.model.tree import TREE

Array = NDArray[np.float64]
NO_FORM = -2  # the number of what the compiled rollout cannot roll out
SLOPE = 1e-4  # of a parameter, or 1: the finite difference of an acceleration


@dataclass(frozen=True)
class SimulatedDynamics(Dynamics):
    """One joint that a user's step function moves."""

    simulator: Simulator
    name = "simulator"
    joints = 1

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
        return self._moved(with_hidden, applied[:, 0], parameters, span)[:, :MOTION]

    def rollout(
        self,
        parameters: Array,
        initial: Array,
        applied: Array,
        h_s: Array,
        steps: NDArray[np.int64],
    ) -> Array:
        vectors, (windows, samples) = len(parameters), applied.shape[:2]
        out = np.empty((vectors, windows, samples, MOTION))
        numbers = np.repeat(parameters.T, windows, axis=1)
        hidden = np.tile(np.array(self.simulator.begins), (vectors * windows, 1))
        now = np.concatenate([np.tile(initial, (vectors, 1)), hidden], axis=1)
        for i in range(samples):
            out[:, :, i] = now[:, :MOTION].reshape(vectors, windows, MOTION)
            for step in range(int(steps[:, i].max(initial=0)) if i + 1 < samples else 0):
                runs = np.flatnonzero(np.tile(steps[:, i] > step, vectors))
                u, span = (np.tile(x[:, i], vectors)[runs] for x in (applied[:, :, 0], h_s))
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

    def acceleration(self, parameters: Array, q: Array, v: Array, u: Array) -> Array:
        """The mean acceleration `(n,)` over a step from positions, velocities and commands
        `(n,)`."""
        h_s = self.simulator.timestep_s
        states = np.stack([q, v], axis=1)
        return np.asarray((self.step(states, u[:, None], parameters, h_s)[:, 1] - v) / h_s)

    def drive(self, parameters: Sequence[float], joint: int, q: Array, applied: Array) -> Array:
        numbers, zero = np.array(parameters), np.zeros(len(q))
        driven = self.acceleration(numbers, q, zero, applied)
        return driven - self.acceleration(numbers, q, zero, zero)

    def neutral(self, parameters: Sequence[float], joint: int, q: Array) -> Array:
        return np.zeros(len(q))

    def inertia(self, parameters: Array, q: Array) -> Array:
        return np.ones((len(q), 1, 1))

    def own_regressors(self, states: Array, applied: Array) -> Array:
        """How the acceleration changes with each parameter, near the nominal ones."""
        numbers = np.array(list(self.simulator.parameters.values()))
        return self.slopes(numbers, states, applied)

    def slopes(self, numbers: Array, states: Array, applied: Array) -> Array:
        """How the acceleration changes with each of some parameters, `(n, parameters)`."""
        columns = []
        for i, value in enumerate(numbers):
            by = SLOPE * (abs(value) or 1.0)
            ends = [
                self.acceleration(
                    numbers + sign * by * np.eye(len(numbers))[i],
                    states[:, 0],
                    states[:, 1],
                    applied[:, 0],
                )
                for sign in (1.0, -1.0)
            ]
            columns.append((ends[0] - ends[1]) / (2.0 * by))
        return np.stack(columns, axis=1)

    has_own_numbers = True

    def without_dry_friction(self, parameters: Array) -> Array:
        return parameters

    @cached_property
    def form(self) -> Form:  # type: ignore[override]
        return Form(
            Block(len(self.simulator.parameters)),
            NO_FORM,
            np.zeros((1, TREE)),
            np.array([self.size(list(self.simulator.parameters.values()))]),
            self.simulator,
        )

    def size(self, parameters: Sequence[float]) -> float:
        """The force that gives the joint at rest, with some parameters, a unit of acceleration; 1
        where it takes none. Raises BadSimulator."""
        simulator = self.simulator
        if not simulator.takes_force:
            return 1.0
        state = np.array([[0.0, 0.0, *simulator.begins]])
        given = zip(simulator.parameters, parameters, strict=True)
        lanes = {name: np.array([float(x)]) for name, x in given}
        after = [
            simulator.moved(state, np.zeros(1), lanes, None, np.array([force]))[0, 1]
            for force in (0.0, 1.0)
        ]
        mobility = (after[1] - after[0]) / simulator.timestep_s
        if not mobility > 0.0:
            raise BadSimulator(
                f"{simulator.name} takes a force that does not move the joint its way",
                hint="Add `force` where the simulator adds the forces of its drive.",
            )
        return float(1.0 / mobility)

    def _moved(self, state: Array, u: Array, parameters: Array, h_s: Array) -> Array:
        simulator = self.simulator
        numbers = np.broadcast_to(
            parameters[:, None] if parameters.ndim == 1 else parameters,
            (len(simulator.parameters), len(state)),
        )
        lanes = dict(zip(simulator.parameters, numbers, strict=True))
        return simulator.moved(state, u, lanes, h_s)
