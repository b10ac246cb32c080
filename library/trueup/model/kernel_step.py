"""One step of the compiled rollout: forces of a robot's tree at its joints, and the kick and drift
of its joints, as plain functions that the kernel calls."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba.extending import register_jitable

from trueup.model.block import BLOCK
from trueup.model.dry_friction import project_friction
from trueup.model.inverse import invert_lanes
from trueup.model.ports import (
    DRIVE,
    LEVEL,
    MOBILITY,
    PASSIVE,
    Q_AT,
    SPRING,
    V_AT,
    A,
    H,
    Q,
    U,
    V,
    at,
)
from trueup.model.rigid_body import crba, joint_forces, lanes_of, rnea
from trueup.model.tree import DAMPING, FRICTION, GAIN, JOINT, LIMIT, LINK, OFFSET, SERVO


def to_error(here: Any, servo: Any, gains: Any, offset: Any, goal_here: Any) -> None:
    """A servo's command less the one that would hold it where it is, which `goal_here` `(lanes,)`
    keeps."""
    for lane in range(BLOCK):
        goal_here[lane] = (servo[lane] * here[at(Q_AT, lane)] - offset) / gains[lane]
        here[at(U, lane)] -= goal_here[lane]


def accelerate(
    p: Any, tree: Any, sizes: Any, alpha: Any, common: Any, signals: Any, links: Any,
    inverse_mass: Any, room: Any, motion: Any, forces: Any, beyond: Any,
) -> None:  # fmt: skip
    """Forces of a tree at each joint, as accelerations of the joint's own inertia, and the inverse
    mass matrix `inverse_mass`. `motion` `(4, joints, lanes)` becomes the positions and velocities
    at which the step acts, the velocities before it and the commands."""
    n = len(tree)
    q_at, v_at, v, u = motion[0], motion[1], motion[2], motion[3]
    for j in range(n):
        here = signals[j]
        for lane in range(BLOCK):
            q_at[j, lane], v_at[j, lane] = here[at(Q_AT, lane)], here[at(V_AT, lane)]
            v[j, lane], u[j, lane] = here[at(V, lane)], here[at(U, lane)]
    crba(tree, p, q_at, links, inverse_mass)  # the mass matrix, which is inverted in place
    for j in range(n):
        own = inverse_mass[j, lanes_of(j)]
        damping = p[LINK * n + JOINT * j + DAMPING]
        for lane in range(BLOCK):
            own[lane] += (1.0 - alpha) * common[at(H, lane)] * damping[lane]
    invert_lanes(inverse_mass, room)
    rnea(tree, v, links, forces)
    joint_forces(tree, p, u, q_at, v, forces)
    if alpha > 0.0:
        for j in range(n):
            for k in range(n):
                to, by, here = v_at[j], inverse_mass[j, lanes_of(k)], forces[k]
                more = beyond[k]  # what effects did in the last step
                for lane in range(BLOCK):
                    to[lane] += alpha * common[at(H, lane)] * by[lane] * (here[lane] + more[lane])
        rnea(tree, v_at, links, forces)
        # damping takes the velocity of the step's end, see the mass matrix
        joint_forces(tree, p, u, q_at, v, forces)
    for j in range(n):
        here = signals[j]
        for lane in range(BLOCK):
            here[at(V_AT, lane)] = v_at[j, lane]
            here[at(A, lane)] = forces[j, lane] / sizes[j]


def part_forces(
    p: Any, tree: Any, sizes: Any, signals: Any, links: Any, inverse_mass: Any, motion: Any,
    forces: Any, free: Any, nothing: Any,
) -> None:  # fmt: skip
    """What effects ask of a tree's acceleration at each joint: the drive's part, the spring's, the
    passive one, and the mobility."""
    n, q_at, v_at, u = len(tree), motion[0], motion[1], motion[3]
    rnea(tree, v_at, links, free)
    joint_forces(tree, p, nothing, q_at, nothing, free)
    for j in range(n):
        gains, servo = p[LINK * n + JOINT * j + GAIN], p[LINK * n + JOINT * j + SERVO]
        limit, here = tree[j, LIMIT], signals[j]
        for lane in range(BLOCK):  # a servo drives by its error
            idle = tree[j, OFFSET] - servo[lane] * q_at[j, lane]
            driven = min(max(idle + gains[lane] * u[j, lane], -limit), limit)
            resting = min(max(idle, -limit), limit)
            here[at(DRIVE, lane)] = driven / sizes[j]
            here[at(SPRING, lane)] = (free[j, lane] - resting) / sizes[j]
            here[at(MOBILITY, lane)] = inverse_mass[j, j * BLOCK + lane] * sizes[j]
            here[at(PASSIVE, lane)] = 0.0
        for k in range(n):
            for lane in range(BLOCK):
                here[at(PASSIVE, lane)] += inverse_mass[j, k * BLOCK + lane] * forces[k, lane]
        for lane in range(BLOCK):
            here[at(PASSIVE, lane)] = (
                here[at(PASSIVE, lane)] / here[at(MOBILITY, lane)] - here[at(DRIVE, lane)]
            )


def pass_through_links(signals: Any, sizes: Any, inverse_mass: Any, forces: Any) -> None:
    """What effects at the other joints do to a joint comes through the links."""
    n = len(forces)
    for j in range(n):
        here = signals[j]
        for k in range(n):
            if k == j:
                continue
            other = signals[k]
            for lane in range(BLOCK):
                more = other[at(A, lane)] * sizes[k] - forces[k, lane]
                here[at(PASSIVE, lane)] += (
                    inverse_mass[j, k * BLOCK + lane] * more / here[at(MOBILITY, lane)]
                )


def move_joint(alpha: Any, here: Any, common: Any) -> None:
    """One joint's step: the kick, dry friction as a projection, the drift."""
    for lane in range(BLOCK):
        h = common[at(H, lane)]
        after = here[at(V, lane)] + h * here[at(A, lane)]
        after = np.copysign(max(abs(after) - h * here[at(LEVEL, lane)], 0.0), after)
        here[at(V, lane)] = after
        here[at(Q, lane)] = here[at(Q_AT, lane)] + (1.0 - alpha) * h * after


def move_tree(
    p: Any, sizes: Any, alpha: Any, signals: Any, common: Any, inverse_mass: Any, held: Any,
    free: Any, impulse: Any, by: Any,
) -> None:  # fmt: skip
    """A tree's step: the kick, dry friction of all joints at once as a projection, the drift."""
    n = len(free)
    for j in range(n):
        friction, here = p[LINK * n + JOINT * j + FRICTION], signals[j]
        for lane in range(BLOCK):
            held[j, lane] = common[at(H, lane)] * (
                sizes[j] * here[at(LEVEL, lane)] + friction[lane]
            )
            free[j, lane] = here[at(V, lane)]
        for k in range(n):
            to, coupled = free[j], inverse_mass[j, lanes_of(k)]
            other = signals[k]
            for lane in range(BLOCK):
                to[lane] += common[at(H, lane)] * coupled[lane] * sizes[k] * other[at(A, lane)]
    project_friction(inverse_mass, held, free, impulse, by)
    for j in range(n):
        here = signals[j]
        for lane in range(BLOCK):
            here[at(V, lane)] = free[j, lane]
            here[at(Q, lane)] = (
                here[at(Q_AT, lane)] + (1.0 - alpha) * common[at(H, lane)] * free[j, lane]
            )


for _function in (
    to_error, accelerate, part_forces, pass_through_links, move_joint, move_tree,
):  # fmt: skip
    register_jitable(forceinline=True)(_function)  # compiled into the kernel
