"""Dynamics of a robot's tree on arrays: mass matrix and forces, in the world's axes, all joints at
once.

The same text runs on arrays, and on symbols that write down what is done with them. It is the
reference of the compiled algorithms (`rigid_body.py`), which go from link to link in each link's
own axes. Shapes are written without the leading `(n,)` of lanes. Source: R. Featherstone, Rigid
Body Dynamics Algorithms (2008), sections 5.3 (recursive Newton-Euler) and 6.2 (composite rigid
bodies), with spatial vectors about the world's origin.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trueup.model.tree import (
    ARMATURE,
    DAMPING,
    FRAME,
    FRICTION,
    GAIN,
    GRAVITY,
    JOINT,
    LIMIT,
    LINK,
    NO_LIMIT,
    OFFSET,
    PARENT,
    REST,
    SERVO,
    SLIDE,
    STIFFNESS,
    SWEEPS,
    ZERO,
)

Array = NDArray[np.float64]
NEXT, AFTER_NEXT = [1, 2, 0], [2, 0, 1]  # of x, y, z
ALONG = 2  # a joint acts along, or about, its link's z axis
MASS, FIRST_MOMENT, SECOND_MOMENT = 0, slice(1, 4), (4, 5, 6, 7, 8, 9)  # xx yy zz xy xz yz
ROWS = (0, 3, 4), (3, 1, 5), (4, 5, 2)  # of a symmetric matrix, among its second moments
ONES = np.ones((3, 1))
BESIDE_X = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])


@dataclass(frozen=True)
class Links:
    """Where links are: rotations `turn` `(joints, 3, 3)` to the world's axes, their origins and the
    way there from their parents' `(joints, 3)`, and the axes of their joints `(joints, 3)`."""

    turn: Any
    origin: Any
    way: Any
    axis: Any


@dataclass(frozen=True)
class TreeDynamics:
    """A tree with `constants` `(joints, TREE)` and `numbers` `(parameters,)`, or `(n, parameters)`
    for each lane its own."""

    constants: Array
    numbers: Array

    @property
    def joints(self) -> int:
        """How many joints there are."""
        return len(self.constants)

    @cached_property
    def inertial(self) -> Array:
        """The links' numbers, `(joints, LINK)`."""
        given = self.numbers[..., : LINK * self.joints]
        return np.asarray(given.reshape(*given.shape[:-1], self.joints, LINK))

    @cached_property
    def at_joint(self) -> Array:
        """The joints' numbers, `(joints, JOINT)`."""
        given = self.numbers[..., LINK * self.joints :]
        return np.asarray(given.reshape(*given.shape[:-1], self.joints, JOINT))

    @cached_property
    def carried(self) -> Array:
        """1 where a joint, by row, is another or carries it, `(joints, joints)`."""
        carried = np.eye(self.joints)
        for j, parent in enumerate(self.constants[:, PARENT].astype(int)):
            if parent >= 0:
                carried[:, j] += carried[:, parent]
        return carried

    @cached_property
    def slides(self) -> Array:
        """1 for a joint that slides, 0 for a hinge, `(joints, 1)`."""
        return (self.constants[:, SLIDE] > 0.0).astype(float)[:, None]

    def links(self, q: Any) -> Links:
        """Where links are at positions `(joints,)`."""
        moved = q - self.constants[:, ZERO]
        cosine, sine = np.cos(moved), np.sin(moved)
        turns: list[Any] = []
        origins: list[Any] = []
        ways: list[Any] = []
        for j, c in enumerate(self.constants):
            base, place = c[FRAME : FRAME + 9].reshape(3, 3).T, c[FRAME + 9 : ZERO]
            nothing = 0.0 * moved[..., j, None]  # with as many lanes as the rest
            turn, way = base + nothing[..., None], place + nothing
            if c[SLIDE] > 0.0:
                way = place + moved[..., j, None] * base[:, ALONG]
            else:
                turn = (
                    cosine[..., j, None, None] * (base * [1.0, 1.0, 0.0])
                    + sine[..., j, None, None] * (base @ BESIDE_X)
                    + base * [0.0, 0.0, 1.0]
                )
            parent = int(c[PARENT])
            if parent >= 0:
                turn, way = turns[parent] @ turn, times(turns[parent], way)
            turns.append(turn)
            ways.append(way)
            origins.append(origins[parent] + way if parent >= 0 else way)
        turn, origin, way = np.stack(turns, -3), np.stack(origins, -2), np.stack(ways, -2)
        return Links(turn, origin, way, turn[..., ALONG])

    def mass(self, at: Links) -> Any:
        """The mass matrix, armatures included, `(joints, joints)`."""
        mass, first, second = self._inertias(at)
        first_about_world = first + mass * at.origin
        composite_mass = self.carried @ mass
        composite_first = self.carried @ first_about_world
        # a unit velocity of each joint: how fast all that it carries turns, and moves at the
        # world's origin
        turning = at.axis * (1.0 - self.slides)
        moving = _cross(at.origin, turning) + at.axis * self.slides
        # momentum of what each joint carries, the second moments column by column
        force = composite_mass * moving + _cross(turning, composite_first)
        moment = _cross(composite_first, moving)
        trace = (2.0 * at.origin * first + mass * at.origin * at.origin) @ ONES
        for k, unit in enumerate(np.eye(3)):
            about_world = (
                second[..., k]
                + trace * unit
                - at.origin * first[..., k, None]
                - first_about_world * at.origin[..., k, None]
            )
            moment = moment + (self.carried @ about_world) * turning[..., k, None]
        coupled = turning @ np.swapaxes(moment, -1, -2) + moving @ np.swapaxes(force, -1, -2)
        upper = coupled * self.carried  # of a joint and one that it carries
        lower = np.swapaxes(coupled * (self.carried - np.eye(self.joints)), -1, -2)
        return upper + lower + self.diagonal(ARMATURE)

    def bias(self, at: Links, v: Any) -> Any:
        """Centrifugal, Coriolis and gravity force at each joint, `(joints,)`, at velocities."""
        mass, first, second = self._inertias(at)
        reach, above = self.carried.T, self.carried.T - np.eye(self.joints)
        by_joint = at.axis * v[..., None]
        turning = by_joint * (1.0 - self.slides)
        rate, parent_rate = reach @ turning, above @ turning
        gained = _cross(parent_rate, turning)
        rate_change, parent_rate_change = reach @ gained, above @ gained
        gained = (
            _cross(parent_rate_change, at.way)
            + _cross(parent_rate, _cross(parent_rate, at.way))
            + 2.0 * _cross(parent_rate, by_joint * self.slides)
        )
        acceleration = reach @ gained - self.constants[0, GRAVITY:]  # of each link's origin
        force = mass * acceleration + _cross(rate_change, first) + _cross(rate, _cross(rate, first))
        moment = (
            _cross(first, acceleration)
            + times(second, rate_change)
            + _cross(rate, times(second, rate))
        )
        carried_force = self.carried @ force
        about_world = self.carried @ (moment + _cross(at.origin, force))
        carried_moment = about_world - _cross(at.origin, carried_force)
        at_joint = carried_force * self.slides + carried_moment * (1.0 - self.slides)
        return ((at.axis * at_joint) @ ONES)[..., 0]

    def _inertias(self, at: Links) -> tuple[Array, Any, Any]:
        """Masses `(joints, 1)`, first moments `(joints, 3)` and second moments `(joints, 3, 3)` of
        the links about their origins, in the world's axes."""
        given = self.inertial
        second = given[..., SECOND_MOMENT][..., ROWS]
        return (
            given[..., MASS, None],
            times(at.turn, given[..., FIRST_MOMENT]),
            at.turn @ second @ np.swapaxes(at.turn, -1, -2),
        )

    def diagonal(self, number: int) -> Array:
        """One of the joints' numbers as a diagonal matrix, `(joints, joints)`."""
        return self.at_joint[..., number, None] * np.eye(self.joints)

    def drive(self, u: Any, q: Any) -> Any:
        """What the actuators give under commands at positions, `(joints,)`."""
        return self.limited(
            self.at_joint[..., GAIN] * u - self.at_joint[..., SERVO] * q + self.constants[:, OFFSET]
        )

    def limited(self, force: Any) -> Any:
        """The actuators' forces within their limits, `(joints,)`."""
        limit = self.constants[:, LIMIT]
        if (limit >= NO_LIMIT).all():
            return force
        return np.minimum(np.maximum(force, -limit), limit)

    def passive(self, q: Any, v: Any) -> Any:
        """What springs and dampers give, `(joints,)`."""
        spring = self.at_joint[..., STIFFNESS] * (q - self.constants[:, REST])
        return -(spring + self.at_joint[..., DAMPING] * v)

    def braked(self, inverse_mass: Any, held: Any, v: Any, rubs: list[int]) -> Any:
        """Velocities `(joints,)` after dry friction at the joints that rub, whose impulses are no
        larger than `held`, each of which only ever stops its joint.

        Source: J. J. Moreau (1988); the sweeps: M. Jean, Computer Methods in Applied Mechanics and
        Engineering 177 (1999).
        """
        impulses: dict[int, Any] = dict.fromkeys(rubs, 0.0)
        by_impulse = {j: inverse_mass[..., j] for j in rubs}
        inertia = {j: 1.0 / by_impulse[j][..., j] for j in rubs}
        most = {j: held[..., j] for j in rubs}
        for _ in range(SWEEPS if len(rubs) > 1 else len(rubs)):
            for j in rubs:
                wanted = impulses[j] - v[..., j] * inertia[j]
                wanted = np.minimum(np.maximum(wanted, -most[j]), most[j])
                v = v + by_impulse[j] * (wanted - impulses[j])[..., None]
                impulses[j] = wanted
        return v

    def rubbing(self) -> list[int]:
        """The joints that have a friction loss of their own."""
        rubs = self.at_joint[..., FRICTION].reshape(-1, self.joints) > 0.0
        return [int(j) for j in np.flatnonzero(rubs.any(axis=0))]


def inverse(matrix: Any, size: int) -> Any:
    """The inverse of a symmetric positive definite matrix `(size, size)`, by Gauss-Jordan
    elimination without pivoting."""
    solved: Any = np.eye(size)
    for i, unit in enumerate(np.eye(size)):
        pivot = matrix[..., i, i, None, None]
        factor = matrix[..., i, None] - unit[:, None]
        # the row by itself becomes 1 on the diagonal, the others lose what they have of it
        solved = solved - factor * (solved[..., i, None, :] / pivot)
        matrix = matrix - factor * (matrix[..., i, None, :] / pivot)
    return solved


def times(matrix: Any, vector: Any) -> Any:
    """A matrix `(…, rows, columns)` times a vector `(…, columns)`."""
    return (matrix @ vector[..., None])[..., 0]


def _cross(a: Any, b: Any) -> Any:
    """The cross product of vectors `(…, 3)`."""
    return a[..., NEXT] * b[..., AFTER_NEXT] - a[..., AFTER_NEXT] * b[..., NEXT]
