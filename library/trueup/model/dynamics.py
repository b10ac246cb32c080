"""Dynamics: how a state moves on under an applied command.

A state is positions, then velocities, `(n, 2 x joints)`; a command `(n, joints)`, 0 where a joint
has no actuator. `CompiledFamily` makes dynamics from a family of one joint, `CompiledTree` from a
robot's tree of joints. Nothing above asks which, and both obey the same laws.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from trueup.model.block import BLOCK, FILTERS, Block
from trueup.model.effect import effects
from trueup.model.family import Family, families
from trueup.model.joint_effects import JointEffects
from trueup.model.simulator.simulator import Simulator
from trueup.model.tree import (
    FRICTION,
    GAIN,
    JOINT,
    LINK,
    OFFSET,
    SERVO,
    TREE,
    ZERO,
    Tree,
)
from trueup.model.tree_dynamics import TreeDynamics
from trueup.model.tree_regressors import mass_matrix
from trueup.model.tree_step import TreeStep

Array = NDArray[np.float64]
TREE_FORM = -1  # the number of a tree, where a family has its own


@dataclass(frozen=True, eq=False)
class Form:
    """What a rollout reads of a nominal model.

    `block` is how its parameters lie; `family` a family's number, -1 for a tree; `tree` `(joints,
    TREE)`; `sizes` `(joints,)` the inertia by which an effect's forces are divided, so that they
    are accelerations for every maker. A `simulator` of the user's own is rolled out in numpy.
    """

    block: Block
    family: int
    tree: Array
    sizes: Array
    simulator: Simulator | None = None

    @property
    def of_tree(self) -> bool:
        """Whether it is a robot's tree, and not one joint of a family."""
        return self.family == TREE_FORM

    @property
    def of_robot(self) -> bool:
        """Whether its joints move each other: a robot's tree, or a simulator of several joints."""
        return self.of_tree or self.block.joints > 1

    @property
    def per_inertia(self) -> bool:
        """Whether forces are accelerations: of a family, and of a simulator that takes none."""
        return not self.of_tree and (self.simulator is None or not self.simulator.takes_force)

    @property
    def filters(self) -> int:
        """How many filters one rollout holds."""
        return FILTERS if self.simulator is None else 1


class Dynamics(ABC):
    """One semi-implicit Euler step, and many of them at once."""

    name: str  # a family's, or mjcf
    joints: int
    parameter_names: tuple[str, ...]
    products: tuple[str, ...] = ()  # features of each parameter times what it multiplies
    form: Form

    @abstractmethod
    def step(self, state: Array, applied: Array, parameters: Array, h_s: Array | float) -> Array:
        """State after `h_s` [s]; parameters `(parameters,)` or `(parameters, n)`."""

    @abstractmethod
    def rollout(
        self,
        parameters: Array,
        initial: Array,
        applied: Array,
        h_s: Array,
        steps: NDArray[np.int64],
    ) -> Array:
        """States at every sample, compiled, for all lanes.

        parameters `(vectors, parameters)`; initial `(windows, 2 x joints)`; applied `(windows,
        samples, joints)`; `h_s` [s] and `steps` `(windows, samples)`: between sample i and i+1 lie
        `steps[i]` steps of `h_s[i]`. A window stops where steps are 0. Returns `(vectors, windows,
        samples, 2 x joints)`.
        """

    @abstractmethod
    def drive(self, parameters: Sequence[float], joint: int, q: Array, applied: Array) -> Array:
        """Acceleration that a joint's actuator gives under a command at positions, `(n,)`; in a
        tree, with nothing else in its way."""

    @abstractmethod
    def neutral(self, parameters: Sequence[float], joint: int, q: Array) -> Array:
        """The command under which a joint's actuator gives no force at positions, `(n,)`: 0 but of
        a servo of position."""

    @abstractmethod
    def inertia(self, parameters: Array, q: Array) -> Array:
        """Mass matrices at positions `(n, joints)` in units of each joint's own inertia, `(n,
        joints, joints)`."""

    def own_regressors(self, states: Array, applied: Array) -> Array | None:
        """The factors of a family's numbers in the acceleration `(n, numbers)`, at states `(n, 2)`
        and commands `(n, 1)`; None of a robot, whose numbers show in sums only."""
        return None

    @property
    def has_own_numbers(self) -> bool:
        """Whether each parameter moves the machine in a way of its own, as a family's do."""
        return False

    @property
    def takes_force(self) -> bool:
        """Whether effects can push and hold the joints."""
        return True

    @abstractmethod
    def without_dry_friction(self, parameters: Array) -> Array:
        """The parameters with dry friction, which has no linear part, at 0."""

    def hold(
        self, parameters: Array, states: Array, applied: Array, h_s: float, steps: int
    ) -> Array:
        """States `(n, steps, 2 x joints)` after each of some steps of `h_s` [s] from `(n, 2 x
        joints)`, commands `(n, joints)` held."""
        after = []
        for _ in range(steps):
            states = self.step(states, applied, parameters, h_s)
            after.append(states)
        return np.stack(after, axis=1)

    def transition(self, parameters: Array, h_s: float) -> Array:
        """The unforced update linearised at rest at zero, `(2 x joints, 2 x joints)`."""
        slope = 1e-6  # [rad, m] small against every joint's travel, large against rounding
        basis, parameters = (
            slope * np.eye(2 * self.joints, 2 * self.joints),
            self.without_dry_friction(parameters),
        )
        nothing = np.zeros((2 * self.joints, self.joints))
        moved = self.step(basis, nothing, parameters, h_s) - self.step(
            np.zeros_like(basis), nothing, parameters, h_s
        )
        return np.asarray(moved / slope).T


@dataclass(frozen=True)
class CompiledFamily(Dynamics):
    """One joint of a family; v' = v + h a(q, v, u), then q' = q + h v'."""

    family: type[Family]
    joints = 1

    @property
    def name(self) -> str:  # type: ignore[override]
        return self.family.name

    @property
    def parameter_names(self) -> tuple[str, ...]:  # type: ignore[override]
        return tuple(p.name for p in self.family.params)

    @property
    def products(self) -> tuple[str, ...]:  # type: ignore[override]
        return self.family.products

    def step(self, state: Array, applied: Array, parameters: Array, h_s: Array | float) -> Array:
        q, v = state[:, 0], state[:, 1]
        after = v + h_s * self.family.acceleration(q, v, applied[:, 0], *parameters)
        return np.stack([q + h_s * after, after], axis=1)

    def rollout(
        self,
        parameters: Array,
        initial: Array,
        applied: Array,
        h_s: Array,
        steps: NDArray[np.int64],
    ) -> Array:
        from trueup.model.family_kernel import rollout  # noqa: PLC0415  (numba loads slowly; a server that only serves needs none)

        return rollout(self.family, parameters, initial, applied[:, :, 0], h_s, steps)

    def drive(self, parameters: Sequence[float], joint: int, q: Array, applied: Array) -> Array:
        zero = np.zeros(len(q))
        driven, passive = (
            self.family.acceleration(zero, zero, u, *parameters) for u in (applied, zero)
        )
        return np.asarray(driven - passive)

    def neutral(self, parameters: Sequence[float], joint: int, q: Array) -> Array:
        return np.zeros(len(q))

    def own_regressors(self, states: Array, applied: Array) -> Array:
        columns = self.family.regressors(states[:, 0], states[:, 1], applied[:, 0])
        return np.stack(columns, axis=1)

    has_own_numbers = True

    def without_dry_friction(self, parameters: Array) -> Array:
        return parameters

    def inertia(self, parameters: Array, q: Array) -> Array:
        return np.ones((len(q), 1, 1))

    @cached_property
    def form(self) -> Form:  # type: ignore[override]
        number = list(families()).index(self.family.name)
        return Form(Block.of_family(), number, np.zeros((1, TREE)), np.ones(1))


@dataclass(frozen=True)
class CompiledTree(Dynamics):
    """A robot of rigid links; v' = v + h (M + h D)^-1 (forces - bias), then q' = q + h v', as
    MuJoCo's implicit integrator does.

    Dry friction of the joints is a projection of the velocity, not a soft constraint.
    """

    tree: Tree
    name = "mjcf"

    @property
    def joints(self) -> int:  # type: ignore[override]
        return len(self.tree.joints)

    @property
    def parameter_names(self) -> tuple[str, ...]:  # type: ignore[override]
        return self.tree.parameter_names

    @cached_property
    def form(self) -> Form:  # type: ignore[override]
        masses = mass_matrix(self.tree, self.tree.constants[None, :, ZERO])[0]
        return Form(
            Block(len(self.tree.parameters), self.joints),
            TREE_FORM,
            self.tree.constants,
            np.diag(masses).copy(),
        )

    def drive(self, parameters: Sequence[float], joint: int, q: Array, applied: Array) -> Array:
        first = LINK * self.joints + JOINT * joint
        force = (
            parameters[first + GAIN] * applied
            - parameters[first + SERVO] * q
            + self.tree.constants[joint, OFFSET]
        )
        return np.asarray(force / self.form.sizes[joint])

    def neutral(self, parameters: Sequence[float], joint: int, q: Array) -> Array:
        first = LINK * self.joints + JOINT * joint
        gain, servo = parameters[first + GAIN], parameters[first + SERVO]
        return (
            np.asarray((servo * q - self.tree.constants[joint, OFFSET]) / gain)
            if servo
            else np.zeros(len(q))
        )

    def without_dry_friction(self, parameters: Array) -> Array:
        smooth = np.array(parameters, float)
        smooth[LINK * self.joints + FRICTION :: JOINT] = 0.0
        return smooth

    def inertia(self, parameters: Array, q: Array) -> Array:
        moved = replace(self.tree, parameters=tuple(float(x) for x in parameters))
        return np.asarray(mass_matrix(moved, q) / self.form.sizes[None, :, None])

    def step(self, state: Array, applied: Array, parameters: Array, h_s: Array | float) -> Array:
        """State after `h_s` [s], in numpy."""
        joints, none = self.joints, JointEffects((), 1.0, 0.0)
        numbers = TreeDynamics(self.tree.constants, parameters.T)
        step = TreeStep(self.tree.joints, numbers, [none] * joints, self.form.sizes, 0.0)
        q, v, u = (list(x.T) for x in (state[:, :joints], state[:, joints:], applied))
        q, v, _ = step.advance(q, v, [{}] * joints, u, h_s)  # type: ignore[assignment]
        return np.stack([*q, *v], axis=1)

    def hold(
        self, parameters: Array, states: Array, applied: Array, h_s: float, steps: int
    ) -> Array:
        """States after each of some steps, compiled."""
        held = np.repeat(applied[:, None, :], steps + 1, axis=1)
        runs = np.ones(held.shape[:2], np.int64)
        runs[:, -1] = 0
        spans = np.full(held.shape[:2], h_s)
        return np.asarray(self.rollout(np.array([parameters]), states, held, spans, runs)[0, :, 1:])

    def rollout(
        self,
        parameters: Array,
        initial: Array,
        applied: Array,
        h_s: Array,
        steps: NDArray[np.int64],
    ) -> Array:
        from trueup.model.kernel import kernel  # noqa: PLC0415  (numba loads slowly; a server that only serves needs none)

        windows, samples, joints = applied.shape
        runs = steps.reshape(-1)
        t = np.concatenate([[0.0], np.cumsum((runs * h_s.reshape(-1))[:-1])])
        resets = np.full(windows * samples, -1)
        resets[::samples] = np.arange(windows)
        issued = np.ascontiguousarray(applied.reshape(-1, joints))
        off, observed = np.zeros((len(effects()), joints), np.uint8), np.zeros((len(t), 2 * joints))
        states = np.empty((len(parameters), windows, samples, 2 * joints))
        for first in range(0, len(parameters), BLOCK):
            some = parameters[first : first + BLOCK]
            p = np.repeat(self.form.block.nulls[:, None], BLOCK, axis=1)
            p[: some.shape[1]] = some[0][:, None]
            p[: some.shape[1], : len(some)] = some.T
            out = np.empty((len(t), 2 * joints, BLOCK))
            kernel()(
                p[None], off, self.form.block.nominal, TREE_FORM, self.form.tree, self.form.sizes,
                0.0, np.ones(joints), np.zeros(1), np.array([0, len(t)]), t,
                np.ascontiguousarray(h_s.reshape(-1)), np.ascontiguousarray(runs), issued,
                np.zeros_like(issued), np.zeros_like(issued), resets,
                np.repeat(initial[:, :, None], BLOCK, axis=2), 0, False,
                np.zeros((1, joints, 4, 2, FILTERS)), observed, out,
            )  # fmt: skip
            states[first : first + len(some)] = np.moveaxis(out[:, :, : len(some)], 2, 0).reshape(
                -1, windows, samples, 2 * joints
            )
        return states


def strictly_stable(dynamics: Dynamics, parameters: Array, h_s: float) -> bool:
    """Whether every eigenvalue of the unforced update at rest lies inside the unit circle."""
    return bool(np.abs(np.linalg.eigvals(dynamics.transition(parameters, h_s))).max() < 1.0)
