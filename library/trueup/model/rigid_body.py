"""Rigid bodies in a tree: mass matrix and bias force of a block of lanes, as plain functions that
the compiled rollout calls.

Lanes are innermost, joints outermost, so that the compiler keeps many lanes in one register.

Each link's frame has its origin at its joint and its z axis along it, so a hinge turns about z and
a slide moves along z. A link's ten inertial parameters enter linearly: mass, first moments, second
moments about the frame's origin. Source: R. Featherstone, Rigid Body Dynamics Algorithms (2008),
chapters 5 (recursive Newton-Euler, RNEA) and 6 (composite rigid bodies, CRBA).

    tree     (joints, TREE) constants of each joint, as `Tree.constants` gives them
    p        (parameters, lanes), of which a link's are rows 10 j to 10 j + 9, and behind all links
             a joint's are 6 rows each
    q, v     (joints, lanes) positions and velocities [rad, m, rad/s, m/s]
    links    (joints, LINK_ROWS x lanes) what the algorithms keep of each link, row by row, each row
             a block of lanes. Rows are named below; constant places need no bounds check
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba.extending import register_jitable

from trueup.model.block import BLOCK
from trueup.model.tree import (
    ARMATURE,
    DAMPING,
    FRAME,
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
    ZERO,
)

# Rows of `links`, each the first of as many as its comment says. Vectors are x, y, z in the link's
# own axes, the frame's in its parent's.
AXIS_X, AXIS_Y, AXIS_Z = 0, 3, 6  # 3 each: the link's axes
ORIGIN = 9  # 3: the link's origin [m]
COMPOSITE = 12  # 10: inertia of the link and of all that it carries
TURN_RATE, TURN_ACCELERATION = 22, 25  # 3 each: [rad/s], [rad/s^2]
ACCELERATION = 28  # 3: of the origin, gravity included [m/s^2]
FORCE, MOMENT = 31, 34  # 3 each: on the link, about its origin [N], [N m]
INERTIA = 37  # 10: the link's own
SPEED = 47  # 1: the joint's velocity
LINK_ROWS = 48

MASS, FIRST_MOMENT, SECOND_MOMENT = 0, 1, 4  # of an inertia: 1, 3 (x, y, z), 6 (xx yy zz xy xz yz)
Z = 2  # of a vector: a joint acts along, or about, its link's z axis


def one(rows: Any, row: Any, lane: Any) -> Any:
    """A lane's number in a row."""
    return rows[row * BLOCK + lane]


def three(rows: Any, first: Any, lane: Any) -> Any:
    """A lane's numbers in three rows that follow each other: a vector."""
    at = first * BLOCK + lane
    return rows[at], rows[at + BLOCK], rows[at + 2 * BLOCK]


def six(rows: Any, first: Any, lane: Any) -> Any:
    """A lane's numbers in six rows that follow each other: two vectors, or second moments."""
    return three(rows, first, lane) + three(rows, first + 3, lane)


def put(rows: Any, first: Any, lane: Any, x: Any, y: Any, z: Any) -> None:
    """Write a lane's vector into three rows that follow each other."""
    at = first * BLOCK + lane
    rows[at], rows[at + BLOCK], rows[at + 2 * BLOCK] = x, y, z


def lanes_of(row: Any) -> Any:
    """Where all lanes of a row are."""
    return slice(row * BLOCK, (row + 1) * BLOCK)


def along_joint(slides: Any) -> Any:
    """The row of a link's wrench that acts along its joint: a force of a slide, a moment of a
    hinge."""
    return FORCE + Z if slides else MOMENT + Z


def crba(tree: Any, p: Any, q: Any, links: Any, mass: Any) -> None:
    """The mass matrix with armatures `(joints, joints x lanes)`, by composite rigid bodies.

    Leaves each link's frame and inertias in `links`, which `rnea` reads.
    """
    n = len(tree)
    for j in range(n):
        place(tree[j], q[j], links[j])
        for k in range(LINK):
            composite, own = links[j, lanes_of(COMPOSITE + k)], links[j, lanes_of(INERTIA + k)]
            given = p[LINK * j + k]
            for lane in range(BLOCK):
                composite[lane] = given[lane]
            for lane in range(BLOCK):
                own[lane] = given[lane]
    for j in range(n - 1, 0, -1):
        if tree[j, PARENT] >= 0.0:
            add_inertia(links[j], links[int(tree[j, PARENT])])
    fill_mass(tree, p, links, mass)


def place(joint: Any, q: Any, link: Any) -> None:
    """A link's axes and origin in its parent's, of a joint with constants `(TREE,)` at positions
    `q` `(lanes,)`."""
    slides, zero = joint[SLIDE] > 0.0, joint[ZERO]
    for lane in range(BLOCK):
        link[lane] = 0.0 if slides else q[lane] - zero
    cosines_and_sines(link)
    x0, x1, x2 = joint[FRAME], joint[FRAME + 1], joint[FRAME + 2]
    y0, y1, y2 = joint[FRAME + 3], joint[FRAME + 4], joint[FRAME + 5]
    z0, z1, z2 = joint[FRAME + 6], joint[FRAME + 7], joint[FRAME + 8]
    p0, p1, p2 = joint[FRAME + 9], joint[FRAME + 10], joint[FRAME + 11]
    for lane in range(BLOCK):
        c, s = one(link, 0, lane), one(link, 1, lane)
        along = q[lane] - zero if slides else 0.0
        put(link, AXIS_X, lane, c * x0 + s * y0, c * x1 + s * y1, c * x2 + s * y2)
        put(link, AXIS_Y, lane, c * y0 - s * x0, c * y1 - s * x1, c * y2 - s * x2)
        put(link, AXIS_Z, lane, z0, z1, z2)
        put(link, ORIGIN, lane, p0 + along * z0, p1 + along * z1, p2 + along * z2)


def fill_mass(tree: Any, p: Any, links: Any, mass: Any) -> None:
    """The mass matrix of links whose composite inertias are in `links`."""
    n = len(tree)
    for j in range(n):
        link, slides = links[j], tree[j, SLIDE] > 0.0
        for lane in range(BLOCK):
            m = one(link, COMPOSITE + MASS, lane)
            hx, hy, _ = three(link, COMPOSITE + FIRST_MOMENT, lane)
            _, _, zz, _, xz, yz = six(link, COMPOSITE + SECOND_MOMENT, lane)
            if slides:
                put(link, FORCE, lane, 0.0, 0.0, m)
                put(link, MOMENT, lane, hy, -hx, 0.0)
            else:
                put(link, FORCE, lane, -hy, hx, 0.0)
                put(link, MOMENT, lane, xz, yz, zz)
        own, force = mass[j, lanes_of(j)], link[lanes_of(along_joint(slides))]
        armature = p[LINK * n + JOINT * j + ARMATURE]
        for lane in range(BLOCK):
            own[lane] = force[lane] + armature[lane]
        for k in range(j):
            upper, lower = mass[j, lanes_of(k)], mass[k, lanes_of(j)]
            for lane in range(BLOCK):
                upper[lane] = 0.0
            for lane in range(BLOCK):
                lower[lane] = 0.0
        below, i = j, int(tree[j, PARENT])
        while i >= 0:
            to_parent(links[below], link)
            couple(mass, j, i, link[lanes_of(along_joint(tree[i, SLIDE] > 0.0))])
            below, i = i, int(tree[i, PARENT])


def couple(mass: Any, j: int, k: int, by: Any) -> None:
    """Two joints' entry of the mass matrix, both ways."""
    upper, lower = mass[j, lanes_of(k)], mass[k, lanes_of(j)]
    for lane in range(BLOCK):
        upper[lane] = by[lane]
    for lane in range(BLOCK):
        lower[lane] = by[lane]


def cosines_and_sines(link: Any) -> None:
    """Angles in a link's first row [rad] become their cosines there, and sines in the second.

    By the series at a quarter of what is left of a whole turn, doubled twice: a library's function
    would be called lane by lane.
    """
    for lane in range(BLOCK):
        turns = link[lane] * (0.5 / np.pi)
        x = (turns - np.rint(turns)) * (0.5 * np.pi)
        y = x * x
        s = 1.0 - y / 72 * (1.0 - y / 110 * (1.0 - y / 156))
        s = x * (1.0 - y / 6 * (1.0 - y / 20 * (1.0 - y / 42 * s)))
        c = 1.0 - y / 90 * (1.0 - y / 132 * (1.0 - y / 182))
        c = 1.0 - y / 2 * (1.0 - y / 12 * (1.0 - y / 30 * (1.0 - y / 56 * c)))
        s, c = 2.0 * s * c, 1.0 - 2.0 * s * s
        link[lane], link[BLOCK + lane] = 1.0 - 2.0 * s * s, 2.0 * s * c


def to_parent(frame: Any, link: Any) -> None:
    """The wrench in `link`, about the origin of `frame`, moved to the origin of the frame's parent
    and into its axes."""
    for lane in range(BLOCK):
        f0, f1, f2, n0, n1, n2 = six(link, FORCE, lane)
        x0, x1, x2, y0, y1, y2 = six(frame, AXIS_X, lane)
        z0, z1, z2, p0, p1, p2 = six(frame, AXIS_Z, lane)
        g0 = x0 * f0 + y0 * f1 + z0 * f2
        g1 = x1 * f0 + y1 * f1 + z1 * f2
        g2 = x2 * f0 + y2 * f1 + z2 * f2
        put(link, FORCE, lane, g0, g1, g2)
        k0 = x0 * n0 + y0 * n1 + z0 * n2 + p1 * g2 - p2 * g1
        k1 = x1 * n0 + y1 * n1 + z1 * n2 + p2 * g0 - p0 * g2
        k2 = x2 * n0 + y2 * n1 + z2 * n2 + p0 * g1 - p1 * g0
        put(link, MOMENT, lane, k0, k1, k2)


def add_inertia(link: Any, parent: Any) -> None:
    """A link's composite inertia added to its parent's."""
    for lane in range(BLOCK):
        x0, x1, x2, y0, y1, y2 = six(link, AXIS_X, lane)
        z0, z1, z2, p0, p1, p2 = six(link, AXIS_Z, lane)
        m = one(link, COMPOSITE + MASS, lane)
        hx, hy, hz = three(link, COMPOSITE + FIRST_MOMENT, lane)
        xx, yy, zz, xy, xz, yz = six(link, COMPOSITE + SECOND_MOMENT, lane)
        h0 = x0 * hx + y0 * hy + z0 * hz
        h1 = x1 * hx + y1 * hy + z1 * hz
        h2 = x2 * hx + y2 * hy + z2 * hz
        t00 = x0 * xx + y0 * xy + z0 * xz
        t01 = x0 * xy + y0 * yy + z0 * yz
        t02 = x0 * xz + y0 * yz + z0 * zz
        t10 = x1 * xx + y1 * xy + z1 * xz
        t11 = x1 * xy + y1 * yy + z1 * yz
        t12 = x1 * xz + y1 * yz + z1 * zz
        t20 = x2 * xx + y2 * xy + z2 * xz
        t21 = x2 * xy + y2 * yy + z2 * yz
        t22 = x2 * xz + y2 * yz + z2 * zz
        moved = 2.0 * (p0 * h0 + p1 * h1 + p2 * h2) + m * (p0 * p0 + p1 * p1 + p2 * p2)
        i00 = t00 * x0 + t01 * y0 + t02 * z0 + moved - 2.0 * p0 * h0 - m * p0 * p0
        i11 = t10 * x1 + t11 * y1 + t12 * z1 + moved - 2.0 * p1 * h1 - m * p1 * p1
        i22 = t20 * x2 + t21 * y2 + t22 * z2 + moved - 2.0 * p2 * h2 - m * p2 * p2
        i01 = t00 * x1 + t01 * y1 + t02 * z1 - p0 * h1 - p1 * h0 - m * p0 * p1
        i02 = t00 * x2 + t01 * y2 + t02 * z2 - p0 * h2 - p2 * h0 - m * p0 * p2
        i12 = t10 * x2 + t11 * y2 + t12 * z2 - p1 * h2 - p2 * h1 - m * p1 * p2
        parent[(COMPOSITE + MASS) * BLOCK + lane] += m
        add(parent, COMPOSITE + FIRST_MOMENT, lane, h0 + m * p0, h1 + m * p1, h2 + m * p2)
        add(parent, COMPOSITE + SECOND_MOMENT, lane, i00, i11, i22)
        add(parent, COMPOSITE + SECOND_MOMENT + 3, lane, i01, i02, i12)


def add(rows: Any, first: Any, lane: Any, x: Any, y: Any, z: Any) -> None:
    """Add a vector to a lane's three rows that follow each other."""
    at = first * BLOCK + lane
    rows[at] += x
    rows[at + BLOCK] += y
    rows[at + 2 * BLOCK] += z


def rnea(tree: Any, v: Any, links: Any, force: Any) -> None:
    """Centrifugal, Coriolis and gravity force at each joint, `force` `(joints, lanes)`, by the
    recursive Newton-Euler algorithm without accelerations of the joints.

    Reads the frames and inertias that `crba` left in `links`.
    """
    for j in range(len(tree)):
        link, i, slides = links[j], int(tree[j, PARENT]), tree[j, SLIDE] > 0.0
        if i >= 0:
            here = link[TURN_RATE * BLOCK : FORCE * BLOCK]
            there = links[i, TURN_RATE * BLOCK : FORCE * BLOCK]
            for at in range((FORCE - TURN_RATE) * BLOCK):
                here[at] = there[at]
        else:
            g0, g1, g2 = -tree[j, GRAVITY], -tree[j, GRAVITY + 1], -tree[j, GRAVITY + 2]
            for lane in range(BLOCK):
                put(link, TURN_RATE, lane, 0.0, 0.0, 0.0)
                put(link, TURN_ACCELERATION, lane, 0.0, 0.0, 0.0)
                put(link, ACCELERATION, lane, g0, g1, g2)
        speeds, given = link[lanes_of(SPEED)], v[j]
        for lane in range(BLOCK):
            speeds[lane] = given[lane]
        move_link(link, slides)
        wrench(link)
    gather(tree, links, force)


def move_link(link: Any, slides: Any) -> None:
    """A link's motion, from its parent's in the parent's axes to its own in its own axes."""
    for lane in range(BLOCK):
        w0, w1, w2, e0, e1, e2 = six(link, TURN_RATE, lane)
        g0, g1, g2 = three(link, ACCELERATION, lane)
        x0, x1, x2, y0, y1, y2 = six(link, AXIS_X, lane)
        z0, z1, z2, p0, p1, p2 = six(link, AXIS_Z, lane)
        speed = one(link, SPEED, lane)
        along, square = w0 * p0 + w1 * p1 + w2 * p2, w0 * w0 + w1 * w1 + w2 * w2
        h0 = g0 + e1 * p2 - e2 * p1 + w0 * along - square * p0
        h1 = g1 + e2 * p0 - e0 * p2 + w1 * along - square * p1
        h2 = g2 + e0 * p1 - e1 * p0 + w2 * along - square * p2
        u0, u1 = x0 * w0 + x1 * w1 + x2 * w2, y0 * w0 + y1 * w1 + y2 * w2
        u2 = z0 * w0 + z1 * w1 + z2 * w2
        r0, r1 = x0 * e0 + x1 * e1 + x2 * e2, y0 * e0 + y1 * e1 + y2 * e2
        r2 = z0 * e0 + z1 * e1 + z2 * e2
        c0, c1 = x0 * h0 + x1 * h1 + x2 * h2, y0 * h0 + y1 * h1 + y2 * h2
        c2 = z0 * h0 + z1 * h1 + z2 * h2
        if slides:
            c0, c1 = c0 + 2.0 * u1 * speed, c1 - 2.0 * u0 * speed
        else:
            r0, r1, u2 = r0 + u1 * speed, r1 - u0 * speed, u2 + speed
        put(link, TURN_RATE, lane, u0, u1, u2)
        put(link, TURN_ACCELERATION, lane, r0, r1, r2)
        put(link, ACCELERATION, lane, c0, c1, c2)


def wrench(link: Any) -> None:
    """Force and moment that a link's own inertia needs for its motion."""
    for lane in range(BLOCK):
        u0, u1, u2, r0, r1, r2 = six(link, TURN_RATE, lane)
        c0, c1, c2 = three(link, ACCELERATION, lane)
        m = one(link, INERTIA + MASS, lane)
        x0, x1, x2 = three(link, INERTIA + FIRST_MOMENT, lane)
        xx, yy, zz, xy, xz, yz = six(link, INERTIA + SECOND_MOMENT, lane)
        along, square = u0 * x0 + u1 * x1 + u2 * x2, u0 * u0 + u1 * u1 + u2 * u2
        s0 = xx * u0 + xy * u1 + xz * u2
        s1 = xy * u0 + yy * u1 + yz * u2
        s2 = xz * u0 + yz * u1 + zz * u2
        f0 = m * c0 + r1 * x2 - r2 * x1 + u0 * along - square * x0
        f1 = m * c1 + r2 * x0 - r0 * x2 + u1 * along - square * x1
        f2 = m * c2 + r0 * x1 - r1 * x0 + u2 * along - square * x2
        put(link, FORCE, lane, f0, f1, f2)
        k0 = xx * r0 + xy * r1 + xz * r2 + u1 * s2 - u2 * s1 + x1 * c2 - x2 * c1
        k1 = xy * r0 + yy * r1 + yz * r2 + u2 * s0 - u0 * s2 + x2 * c0 - x0 * c2
        k2 = xz * r0 + yz * r1 + zz * r2 + u0 * s1 - u1 * s0 + x0 * c1 - x1 * c0
        put(link, MOMENT, lane, k0, k1, k2)


def gather(tree: Any, links: Any, force: Any) -> None:
    """Each joint's part of the wrenches on its link and on all that it carries."""
    for j in range(len(tree) - 1, -1, -1):
        link, i = links[j], int(tree[j, PARENT])
        carried, to = link[lanes_of(along_joint(tree[j, SLIDE] > 0.0))], force[j]
        for lane in range(BLOCK):
            to[lane] = carried[lane]
        if i >= 0:
            to_parent(link, link)
            here = links[i, FORCE * BLOCK : INERTIA * BLOCK]
            there = link[FORCE * BLOCK : INERTIA * BLOCK]
            for at in range((INERTIA - FORCE) * BLOCK):
                here[at] += there[at]


def joint_forces(tree: Any, p: Any, u: Any, q: Any, v: Any, force: Any) -> None:
    """`force` `(joints, lanes)`, which holds what the links' motion needs, turned into what
    actuators under `u`, springs and dampers leave over for accelerations.
    """
    n = len(tree)
    for j in range(n):
        first, offset, limit = LINK * n + JOINT * j, tree[j, OFFSET], tree[j, LIMIT]
        gain, servo, rest = p[first + GAIN], p[first + SERVO], tree[j, REST]
        stiffness, damping = p[first + STIFFNESS], p[first + DAMPING]
        for lane in range(BLOCK):
            driven = gain[lane] * u[j, lane] - servo[lane] * q[j, lane] + offset
            driven = min(max(driven, -limit), limit)
            passive = stiffness[lane] * (q[j, lane] - rest) + damping[lane] * v[j, lane]
            force[j, lane] = driven - passive - force[j, lane]


for _function in (
    one, three, six, put, add, lanes_of, along_joint, crba, place, fill_mass, couple,
    cosines_and_sines, to_parent, add_inertia, rnea, move_link, wrench, gather, joint_forces,
):  # fmt: skip
    register_jitable(_function)  # compiled into what calls them
