"""Rigid bodies in a tree: mass matrix and bias force of a block of lanes, as plain functions that
the compiled rollout calls.

Lanes are innermost, joints outermost, so that the compiler keeps many lanes in one register.

Each link's frame has its origin at its joint and its z axis along it, so a hinge turns about z and
a slide moves along z. A link's ten inertial parameters enter linearly: mass, first moments, second
moments about the frame's origin. Source: R. Featherstone, Rigid Body Dynamics Algorithms (2008),
chapters 5 (recursive Newton-Euler) and 6 (composite rigid bodies).

    tree     (joints, TREE) constants of each joint, as `Tree.constants` gives them
    p        (parameters, lanes), of which a link's are rows 10 j to 10 j + 9, and behind all links
             a joint's are 6 rows each
    q, v     (joints, lanes) positions and velocities [rad, m, rad/s, m/s]
    room     (joints, ROOM x lanes) what a state needs on the way: axes and origin, composite
             inertia, motion, force and moment, its own inertia and its joint's velocity, each lane
             beside the other: places known to the compiler need no check
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba.extending import register_jitable

from trueup.model.block import BLOCK
from trueup.model.tree import (
    ARMATURE,
    DAMPING,
    GAIN,
    GRAVITY,
    JOINT,
    LIMIT,
    LINK,
    OFFSET,
    PARENT,
    REST,
    SERVO,
    SLIDE,
    STIFFNESS,
    SWEEPS,
    ZERO,
)

ROOM = 48
AXES, ORIGIN, COMPOSITE, SPIN, PULL, FORCE, OWN, SPEED = (
    0,
    9,
    12,
    22,
    28,
    31,
    37,
    47,
)  # first rows of what `room` holds
SETTLED = 1e-12  # [rad/s, m/s] a sweep that changes no velocity by more is the last


def three(rows: Any, first: Any, lane: Any) -> Any:
    """A lane of three rows that follow each other: a vector."""
    at = first * BLOCK + lane
    return rows[at], rows[at + BLOCK], rows[at + 2 * BLOCK]


def six(rows: Any, first: Any, lane: Any) -> Any:
    """The same of six: two vectors, or second moments."""
    at = first * BLOCK + lane
    return (
        rows[at],
        rows[at + BLOCK],
        rows[at + 2 * BLOCK],
        rows[at + 3 * BLOCK],
        rows[at + 4 * BLOCK],
        rows[at + 5 * BLOCK],
    )


def pose(tree: Any, p: Any, q: Any, room: Any, mass: Any) -> None:
    """Axes of all links, and the mass matrix `(joints, joints x lanes)` with armatures."""
    n = len(tree)
    for j in range(n):
        o, slides, zero = room[j], tree[j, SLIDE] > 0.0, tree[j, ZERO]
        for lane in range(BLOCK):
            o[lane] = 0.0 if slides else q[j, lane] - zero
        turn(o)
        x0, x1, x2, y0, y1, y2 = (
            tree[j, 2],
            tree[j, 3],
            tree[j, 4],
            tree[j, 5],
            tree[j, 6],
            tree[j, 7],
        )
        z0, z1, z2, p0, p1, p2 = (
            tree[j, 8],
            tree[j, 9],
            tree[j, 10],
            tree[j, 11],
            tree[j, 12],
            tree[j, 13],
        )
        for lane in range(BLOCK):
            c, s, along = o[lane], o[1 * BLOCK + lane], q[j, lane] - zero if slides else 0.0
            o[lane], o[1 * BLOCK + lane], o[2 * BLOCK + lane] = (
                c * x0 + s * y0,
                c * x1 + s * y1,
                c * x2 + s * y2,
            )
            o[3 * BLOCK + lane], o[4 * BLOCK + lane], o[5 * BLOCK + lane] = (
                c * y0 - s * x0,
                c * y1 - s * x1,
                c * y2 - s * x2,
            )
            o[6 * BLOCK + lane], o[7 * BLOCK + lane], o[8 * BLOCK + lane] = z0, z1, z2
            o[9 * BLOCK + lane], o[10 * BLOCK + lane], o[11 * BLOCK + lane] = (
                p0 + along * z0,
                p1 + along * z1,
                p2 + along * z2,
            )
        for k in range(LINK):
            composite, own, given = (
                o[(12 + k) * BLOCK : (13 + k) * BLOCK],
                o[(37 + k) * BLOCK : (38 + k) * BLOCK],
                p[LINK * j + k],
            )
            for lane in range(BLOCK):
                composite[lane] = given[lane]
            for lane in range(BLOCK):
                own[lane] = given[lane]
    for j in range(n - 1, 0, -1):
        if tree[j, PARENT] >= 0.0:
            add_to_parent(room[j], room[int(tree[j, PARENT])])
    couplings(tree, p, room, mass)


def couplings(tree: Any, p: Any, room: Any, mass: Any) -> None:
    """The mass matrix of links whose composite inertias are in `room`."""
    n, nothing = len(tree), np.zeros(BLOCK)
    for j in range(n):
        o, slides = room[j], tree[j, SLIDE] > 0.0
        for lane in range(BLOCK):
            if slides:
                o[31 * BLOCK + lane], o[32 * BLOCK + lane], o[33 * BLOCK + lane] = (
                    0.0,
                    0.0,
                    o[12 * BLOCK + lane],
                )
                o[34 * BLOCK + lane], o[35 * BLOCK + lane], o[36 * BLOCK + lane] = (
                    o[14 * BLOCK + lane],
                    -o[13 * BLOCK + lane],
                    0.0,
                )
            else:
                o[31 * BLOCK + lane], o[32 * BLOCK + lane], o[33 * BLOCK + lane] = (
                    -o[14 * BLOCK + lane],
                    o[13 * BLOCK + lane],
                    0.0,
                )
                o[34 * BLOCK + lane], o[35 * BLOCK + lane], o[36 * BLOCK + lane] = (
                    o[20 * BLOCK + lane],
                    o[21 * BLOCK + lane],
                    o[18 * BLOCK + lane],
                )
        own, at, armature = (
            mass[j, j * BLOCK : (j + 1) * BLOCK],
            33 if slides else 36,
            p[LINK * n + JOINT * j + ARMATURE],
        )
        force = o[at * BLOCK : (at + 1) * BLOCK]
        for lane in range(BLOCK):
            own[lane] = force[lane] + armature[lane]
        for k in range(j):
            couple(mass, j, k, nothing)
        below, i = j, int(tree[j, PARENT])
        while i >= 0:
            outward(room[below], o)
            at = 33 if tree[i, SLIDE] > 0.0 else 36
            couple(mass, j, i, o[at * BLOCK : (at + 1) * BLOCK])
            below, i = i, int(tree[i, PARENT])


def couple(mass: Any, j: int, k: int, by: Any) -> None:
    """Two joints' entry of the mass matrix, both ways."""
    one, other = mass[j, k * BLOCK : (k + 1) * BLOCK], mass[k, j * BLOCK : (j + 1) * BLOCK]
    for lane in range(BLOCK):
        one[lane] = by[lane]
    for lane in range(BLOCK):
        other[lane] = by[lane]


def turn(o: Any) -> None:
    """Angles in the first row become their cosines there, and sines in the second: the series at a
    quarter of what is left of a whole turn, doubled twice, for a library's function would be called
    lane by lane.
    """
    for lane in range(BLOCK):
        turns = o[lane] * (0.5 / np.pi)
        x = (turns - np.rint(turns)) * (0.5 * np.pi)
        y = x * x
        s = x * (
            1.0
            - y
            / 6
            * (1.0 - y / 20 * (1.0 - y / 42 * (1.0 - y / 72 * (1.0 - y / 110 * (1.0 - y / 156)))))
        )
        c = 1.0 - y / 2 * (
            1.0
            - y
            / 12
            * (1.0 - y / 30 * (1.0 - y / 56 * (1.0 - y / 90 * (1.0 - y / 132 * (1.0 - y / 182)))))
        )
        s, c = 2.0 * s * c, 1.0 - 2.0 * s * s
        o[lane], o[BLOCK + lane] = 1.0 - 2.0 * s * s, 2.0 * s * c


def outward(frame: Any, at: Any) -> None:
    """A force and a moment at a link's origin, turned into what they are at its parent's origin, in
    its axes."""
    for lane in range(BLOCK):
        f0, f1, f2, n0, n1, n2 = six(at, FORCE, lane)
        x0, x1, x2, y0, y1, y2 = six(frame, AXES, lane)
        z0, z1, z2, p0, p1, p2 = six(frame, AXES + 6, lane)
        g0, g1, g2 = (
            x0 * f0 + y0 * f1 + z0 * f2,
            x1 * f0 + y1 * f1 + z1 * f2,
            x2 * f0 + y2 * f1 + z2 * f2,
        )
        at[31 * BLOCK + lane], at[32 * BLOCK + lane], at[33 * BLOCK + lane] = g0, g1, g2
        at[34 * BLOCK + lane] = x0 * n0 + y0 * n1 + z0 * n2 + p1 * g2 - p2 * g1
        at[35 * BLOCK + lane] = x1 * n0 + y1 * n1 + z1 * n2 + p2 * g0 - p0 * g2
        at[36 * BLOCK + lane] = x2 * n0 + y2 * n1 + z2 * n2 + p0 * g1 - p1 * g0


def add_to_parent(a: Any, to: Any) -> None:
    """A link's composite inertia added to its parent's."""
    for lane in range(BLOCK):
        x0, x1, x2, y0, y1, y2 = six(a, AXES, lane)
        z0, z1, z2, p0, p1, p2 = six(a, AXES + 6, lane)
        m, hx, hy, hz = (
            a[12 * BLOCK + lane],
            a[13 * BLOCK + lane],
            a[14 * BLOCK + lane],
            a[15 * BLOCK + lane],
        )
        xx, yy, zz, xy, xz, yz = six(a, COMPOSITE + 4, lane)
        h0, h1, h2 = (
            x0 * hx + y0 * hy + z0 * hz,
            x1 * hx + y1 * hy + z1 * hz,
            x2 * hx + y2 * hy + z2 * hz,
        )
        t00, t01, t02 = (
            x0 * xx + y0 * xy + z0 * xz,
            x0 * xy + y0 * yy + z0 * yz,
            x0 * xz + y0 * yz + z0 * zz,
        )
        t10, t11, t12 = (
            x1 * xx + y1 * xy + z1 * xz,
            x1 * xy + y1 * yy + z1 * yz,
            x1 * xz + y1 * yz + z1 * zz,
        )
        t20, t21, t22 = (
            x2 * xx + y2 * xy + z2 * xz,
            x2 * xy + y2 * yy + z2 * yz,
            x2 * xz + y2 * yz + z2 * zz,
        )
        moved = 2.0 * (p0 * h0 + p1 * h1 + p2 * h2) + m * (p0 * p0 + p1 * p1 + p2 * p2)
        to[12 * BLOCK + lane] += m
        to[13 * BLOCK + lane] += h0 + m * p0
        to[14 * BLOCK + lane] += h1 + m * p1
        to[15 * BLOCK + lane] += h2 + m * p2
        to[16 * BLOCK + lane] += (
            t00 * x0 + t01 * y0 + t02 * z0 + moved - 2.0 * p0 * h0 - m * p0 * p0
        )
        to[17 * BLOCK + lane] += (
            t10 * x1 + t11 * y1 + t12 * z1 + moved - 2.0 * p1 * h1 - m * p1 * p1
        )
        to[18 * BLOCK + lane] += (
            t20 * x2 + t21 * y2 + t22 * z2 + moved - 2.0 * p2 * h2 - m * p2 * p2
        )
        to[19 * BLOCK + lane] += t00 * x1 + t01 * y1 + t02 * z1 - p0 * h1 - p1 * h0 - m * p0 * p1
        to[20 * BLOCK + lane] += t00 * x2 + t01 * y2 + t02 * z2 - p0 * h2 - p2 * h0 - m * p0 * p2
        to[21 * BLOCK + lane] += t10 * x2 + t11 * y2 + t12 * z2 - p1 * h2 - p2 * h1 - m * p1 * p2


def bias(tree: Any, v: Any, room: Any, force: Any) -> None:
    """Centrifugal, Coriolis and gravity force at each joint, `force` `(joints, lanes)`, of lanes
    whose pose is in `room`."""
    n = len(tree)
    for j in range(n):
        o, i, slides = room[j], int(tree[j, PARENT]), tree[j, SLIDE] > 0.0
        if i >= 0:
            here, there = o[22 * BLOCK : 31 * BLOCK], room[i, 22 * BLOCK : 31 * BLOCK]
            for at in range(9 * BLOCK):
                here[at] = there[at]
        else:
            g0, g1, g2 = -tree[j, GRAVITY], -tree[j, GRAVITY + 1], -tree[j, GRAVITY + 2]
            for lane in range(BLOCK):
                for k in range(22, 28):
                    o[k * BLOCK + lane] = 0.0
                o[28 * BLOCK + lane], o[29 * BLOCK + lane], o[30 * BLOCK + lane] = g0, g1, g2
        speeds, given = o[47 * BLOCK : 48 * BLOCK], v[j]
        for lane in range(BLOCK):
            speeds[lane] = given[lane]
        for lane in range(BLOCK):
            w0, w1, w2, e0, e1, e2 = six(o, SPIN, lane)
            (g0, g1, g2), (p0, p1, p2) = three(o, PULL, lane), three(o, ORIGIN, lane)
            x0, x1, x2, y0, y1, y2 = six(o, AXES, lane)
            z0, z1, z2, speed = (
                o[6 * BLOCK + lane],
                o[7 * BLOCK + lane],
                o[8 * BLOCK + lane],
                o[47 * BLOCK + lane],
            )
            along, square = w0 * p0 + w1 * p1 + w2 * p2, w0 * w0 + w1 * w1 + w2 * w2
            h0 = g0 + e1 * p2 - e2 * p1 + w0 * along - square * p0
            h1 = g1 + e2 * p0 - e0 * p2 + w1 * along - square * p1
            h2 = g2 + e0 * p1 - e1 * p0 + w2 * along - square * p2
            u0, u1, u2 = (
                x0 * w0 + x1 * w1 + x2 * w2,
                y0 * w0 + y1 * w1 + y2 * w2,
                z0 * w0 + z1 * w1 + z2 * w2,
            )
            r0, r1, r2 = (
                x0 * e0 + x1 * e1 + x2 * e2,
                y0 * e0 + y1 * e1 + y2 * e2,
                z0 * e0 + z1 * e1 + z2 * e2,
            )
            c0, c1, c2 = (
                x0 * h0 + x1 * h1 + x2 * h2,
                y0 * h0 + y1 * h1 + y2 * h2,
                z0 * h0 + z1 * h1 + z2 * h2,
            )
            if slides:
                c0, c1 = c0 + 2.0 * u1 * speed, c1 - 2.0 * u0 * speed
            else:
                r0, r1, u2 = r0 + u1 * speed, r1 - u0 * speed, u2 + speed
            o[22 * BLOCK + lane], o[23 * BLOCK + lane], o[24 * BLOCK + lane] = u0, u1, u2
            o[25 * BLOCK + lane], o[26 * BLOCK + lane], o[27 * BLOCK + lane] = r0, r1, r2
            o[28 * BLOCK + lane], o[29 * BLOCK + lane], o[30 * BLOCK + lane] = c0, c1, c2
        for lane in range(BLOCK):
            u0, u1, u2, r0, r1, r2 = six(o, SPIN, lane)
            (c0, c1, c2), m, (x0, x1, x2) = (
                three(o, PULL, lane),
                o[OWN * BLOCK + lane],
                three(o, OWN + 1, lane),
            )
            xx, yy, zz, xy, xz, yz = six(o, OWN + 4, lane)
            along, square = u0 * x0 + u1 * x1 + u2 * x2, u0 * u0 + u1 * u1 + u2 * u2
            s0, s1, s2 = (
                xx * u0 + xy * u1 + xz * u2,
                xy * u0 + yy * u1 + yz * u2,
                xz * u0 + yz * u1 + zz * u2,
            )
            o[31 * BLOCK + lane] = m * c0 + r1 * x2 - r2 * x1 + u0 * along - square * x0
            o[32 * BLOCK + lane] = m * c1 + r2 * x0 - r0 * x2 + u1 * along - square * x1
            o[33 * BLOCK + lane] = m * c2 + r0 * x1 - r1 * x0 + u2 * along - square * x2
            o[34 * BLOCK + lane] = (
                xx * r0 + xy * r1 + xz * r2 + u1 * s2 - u2 * s1 + x1 * c2 - x2 * c1
            )
            o[35 * BLOCK + lane] = (
                xy * r0 + yy * r1 + yz * r2 + u2 * s0 - u0 * s2 + x2 * c0 - x0 * c2
            )
            o[36 * BLOCK + lane] = (
                xz * r0 + yz * r1 + zz * r2 + u0 * s1 - u1 * s0 + x0 * c1 - x1 * c0
            )
    gather(tree, room, force)


def gather(tree: Any, room: Any, force: Any) -> None:
    """Each joint's part of the forces on its link and on all that it carries."""
    n = len(tree)
    for j in range(n - 1, -1, -1):
        o, i = room[j], int(tree[j, PARENT])
        at = 33 if tree[j, SLIDE] > 0.0 else 36
        found, to = o[at * BLOCK : (at + 1) * BLOCK], force[j]
        for lane in range(BLOCK):
            to[lane] = found[lane]
        if i >= 0:
            outward(o, o)
            here, there = room[i, 31 * BLOCK : 37 * BLOCK], o[31 * BLOCK : 37 * BLOCK]
            for at in range(6 * BLOCK):
                here[at] += there[at]


def invert_lanes(matrix: Any, into: Any, wide: Any) -> None:
    """Inverses of symmetric positive definite matrices, both `(n, n x lanes)`; the matrices are
    used up. `wide` is room for a row."""
    n = len(matrix)
    for i in range(n):
        row = into[i]
        for at in range(n * BLOCK):
            row[at] = 0.0
        one = row[i * BLOCK : (i + 1) * BLOCK]
        for lane in range(BLOCK):
            one[lane] = 1.0
    for i in range(n):
        spread(matrix[i, i * BLOCK : (i + 1) * BLOCK], wide)
        pivot, solved = matrix[i], into[i]
        for at in range(n * BLOCK):
            pivot[at] /= wide[at]
        for at in range(n * BLOCK):
            solved[at] /= wide[at]
        for j in range(n):
            if j != i:
                spread(matrix[j, i * BLOCK : (i + 1) * BLOCK], wide)
                below, result = matrix[j], into[j]
                for at in range(n * BLOCK):
                    below[at] -= wide[at] * pivot[at]
                for at in range(n * BLOCK):
                    result[at] -= wide[at] * solved[at]


def spread(lanes: Any, wide: Any) -> None:
    """A block of lanes repeated along a row."""
    for k in range(len(wide) // BLOCK):
        part = wide[k * BLOCK : (k + 1) * BLOCK]
        for lane in range(BLOCK):
            part[lane] = lanes[lane]


def invert(matrix: Any, into: Any) -> None:
    """Inverse of one symmetric positive definite matrix, both `(n, n)`; the matrix is used up."""
    n = len(matrix)
    for i in range(n):
        for k in range(n):
            into[i, k] = 1.0 if i == k else 0.0
    for i in range(n):
        over = 1.0 / matrix[i, i]
        for k in range(n):
            matrix[i, k] *= over
            into[i, k] *= over
        for j in range(n):
            if j != i:
                factor = matrix[j, i]
                for k in range(n):
                    matrix[j, k] -= factor * matrix[i, k]
                    into[j, k] -= factor * into[i, k]


def net(tree: Any, p: Any, u: Any, q: Any, v: Any, force: Any) -> None:
    """`force` `(joints, lanes)`, which holds what the links' motion needs, turned into what
    actuators under `u`, springs and dampers leave over for accelerations.
    """
    n = len(tree)
    for j in range(n):
        o, offset, limit, rest = (
            LINK * n + JOINT * j,
            tree[j, OFFSET],
            tree[j, LIMIT],
            tree[j, REST],
        )
        for lane in range(BLOCK):
            driven = p[o + GAIN, lane] * u[j, lane] - p[o + SERVO, lane] * q[j, lane] + offset
            driven = min(max(driven, -limit), limit)
            passive = (
                p[o + STIFFNESS, lane] * (q[j, lane] - rest) + p[o + DAMPING, lane] * v[j, lane]
            )
            force[j, lane] = driven - passive - force[j, lane]


def rub(moves: Any, held: Any, v: Any, impulse: Any) -> None:
    """Dry friction of all joints at once: `v` `(joints, lanes)` after impulses no larger than
    `held`, each of which only ever stops its joint.

    `moves` `(joints, joints x lanes)` is the inverse mass matrix. Source: J. J. Moreau (1988); the
    sweeps: M. Jean, Computer Methods in Applied Mechanics and Engineering 177 (1999).
    """
    n = len(held)
    several = 0
    for j in range(n):
        several += 1 if held[j].max() > 0.0 else 0
        for lane in range(BLOCK):
            impulse[j, lane] = 0.0
    by = np.empty(BLOCK)
    for _ in range(SWEEPS if several > 1 else several):
        largest = 0.0
        for j in range(n):
            if held[j].max() <= 0.0:
                continue
            own = moves[j, j * BLOCK : (j + 1) * BLOCK]
            for lane in range(BLOCK):
                wanted = min(
                    max(impulse[j, lane] - v[j, lane] / own[lane], -held[j, lane]), held[j, lane]
                )
                by[lane] = wanted - impulse[j, lane]
                impulse[j, lane] = wanted
                largest = max(largest, abs(by[lane]) * own[lane])
            for k in range(n):
                there, coupled = v[k], moves[k, j * BLOCK : (j + 1) * BLOCK]
                for lane in range(BLOCK):
                    there[lane] += coupled[lane] * by[lane]
        if largest < SETTLED:
            break


for _function in (
    three,
    six,
    pose,
    couplings,
    couple,
    gather,
    turn,
    outward,
    add_to_parent,
    bias,
    spread,
    invert_lanes,
    invert,
    net,
    rub,
):
    register_jitable(_function)  # compiled into what calls them
