"""One step of the compiled rollout: forces of a robot's tree at its joints, and the kick and drift
of its joints, as plain functions that the kernel calls."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba.extending import register_jitable

from trueup.model.block import BLOCK
from trueup.model.inverse import invert_lanes
from trueup.model.ports import DRIVE, LEVEL, MOBILITY, PASSIVE, Q_AT, SPRING, V_AT, A, H, Q, U, V
from trueup.model.rigid_body import crba, joint_forces, project_friction, rnea
from trueup.model.tree import DAMPING, FRICTION, GAIN, JOINT, LIMIT, LINK, OFFSET, SERVO


def to_error(u: Any, q: Any, servo: Any, gains: Any, offset: Any, goal_here: Any) -> None:
    """A servo's command less the one that would hold it where it is, which `goal_here` keeps; all
    `(lanes,)`."""
    for lane in range(BLOCK):
        goal_here[lane] = (servo[lane] * q[lane] - offset) / gains[lane]
        u[lane] -= goal_here[lane]


def accelerate(
    p: Any, tree: Any, sizes: Any, alpha: Any, common: Any, signals: Any, links: Any,
    inverse_mass: Any, room: Any, forces: Any, beyond: Any,
) -> None:  # fmt: skip
    """Forces of a tree at each joint, as accelerations of the joint's own inertia, and the inverse
    mass matrix `inverse_mass`."""
    n = len(tree)
    q_at, v_at, v, u, a = signals[Q_AT], signals[V_AT], signals[V], signals[U], signals[A]
    crba(tree, p, q_at, links, inverse_mass)  # the mass matrix, which is inverted in place
    for j in range(n):
        own = inverse_mass[j, j * BLOCK : (j + 1) * BLOCK]
        damping = p[LINK * n + JOINT * j + DAMPING]
        for lane in range(BLOCK):
            own[lane] += (1.0 - alpha) * common[H, lane] * damping[lane]
    invert_lanes(inverse_mass, room)
    rnea(tree, v, links, forces)
    joint_forces(tree, p, u, q_at, v, forces)
    if alpha > 0.0:
        for j in range(n):
            for k in range(n):
                to, by, here = v_at[j], inverse_mass[j, k * BLOCK : (k + 1) * BLOCK], forces[k]
                more = beyond[k]  # what effects did in the last step
                for lane in range(BLOCK):
                    to[lane] += alpha * common[H, lane] * by[lane] * (here[lane] + more[lane])
        rnea(tree, v_at, links, forces)
        # damping takes the velocity of the step's end, see the mass matrix
        joint_forces(tree, p, u, q_at, v, forces)
    for j in range(n):
        for lane in range(BLOCK):
            a[j, lane] = forces[j, lane] / sizes[j]


def part_forces(
    p: Any, tree: Any, sizes: Any, signals: Any, links: Any, inverse_mass: Any, forces: Any,
    free: Any, nothing: Any,
) -> None:  # fmt: skip
    """What effects ask of a tree's acceleration at each joint: the drive's part, the spring's, the
    passive one, and the mobility."""
    n, q_at, v_at = len(tree), signals[Q_AT], signals[V_AT]
    rnea(tree, v_at, links, free)
    joint_forces(tree, p, nothing, q_at, nothing, free)
    for j in range(n):
        gains, servo = p[LINK * n + JOINT * j + GAIN], p[LINK * n + JOINT * j + SERVO]
        limit = tree[j, LIMIT]
        for lane in range(BLOCK):  # a servo drives by its error
            idle = tree[j, OFFSET] - servo[lane] * q_at[j, lane]
            driven = min(max(idle + gains[lane] * signals[U, j, lane], -limit), limit)
            resting = min(max(idle, -limit), limit)
            signals[DRIVE, j, lane] = driven / sizes[j]
            signals[SPRING, j, lane] = (free[j, lane] - resting) / sizes[j]
            signals[MOBILITY, j, lane] = inverse_mass[j, j * BLOCK + lane] * sizes[j]
            signals[PASSIVE, j, lane] = 0.0
        for k in range(n):
            for lane in range(BLOCK):
                signals[PASSIVE, j, lane] += inverse_mass[j, k * BLOCK + lane] * forces[k, lane]
        for lane in range(BLOCK):
            signals[PASSIVE, j, lane] = (
                signals[PASSIVE, j, lane] / signals[MOBILITY, j, lane] - signals[DRIVE, j, lane]
            )


def pass_through_links(signals: Any, sizes: Any, inverse_mass: Any, forces: Any) -> None:
    """What effects at the other joints do to a joint comes through the links."""
    n = len(forces)
    for j in range(n):
        for k in range(n):
            if k == j:
                continue
            for lane in range(BLOCK):
                more = signals[A, k, lane] * sizes[k] - forces[k, lane]
                signals[PASSIVE, j, lane] += (
                    inverse_mass[j, k * BLOCK + lane] * more / signals[MOBILITY, j, lane]
                )


def move_joint(alpha: Any, signals: Any, common: Any) -> None:
    """One joint's step: the kick, dry friction as a projection, the drift."""
    for lane in range(BLOCK):
        h = common[H, lane]
        after = signals[V, 0, lane] + h * signals[A, 0, lane]
        after = np.copysign(max(abs(after) - h * signals[LEVEL, 0, lane], 0.0), after)
        signals[V, 0, lane] = after
        signals[Q, 0, lane] = signals[Q_AT, 0, lane] + (1.0 - alpha) * h * after


def move_tree(
    p: Any, sizes: Any, alpha: Any, signals: Any, common: Any, inverse_mass: Any, held: Any,
    free: Any, impulse: Any,
) -> None:  # fmt: skip
    """A tree's step: the kick, dry friction of all joints at once as a projection, the drift."""
    n = len(free)
    for j in range(n):
        for lane in range(BLOCK):
            held[j, lane] = common[H, lane] * (
                sizes[j] * signals[LEVEL, j, lane] + p[LINK * n + JOINT * j + FRICTION, lane]
            )
            free[j, lane] = signals[V, j, lane]
        for k in range(n):
            to, by = free[j], inverse_mass[j, k * BLOCK : (k + 1) * BLOCK]
            for lane in range(BLOCK):
                to[lane] += common[H, lane] * by[lane] * sizes[k] * signals[A, k, lane]
    project_friction(inverse_mass, held, free, impulse)
    for j in range(n):
        for lane in range(BLOCK):
            signals[V, j, lane] = free[j, lane]
            signals[Q, j, lane] = (
                signals[Q_AT, j, lane] + (1.0 - alpha) * common[H, lane] * free[j, lane]
            )


for _function in (
    to_error, accelerate, part_forces, pass_through_links, move_joint, move_tree,
):  # fmt: skip
    register_jitable(forceinline=True)(_function)  # compiled into the kernel
