"""Regressors of a robot's tree: the force at each joint as a linear function of the inertial
numbers of its links, on arrays.

The compiled rollout (`rigid_body.py`) is held to this in the tests. Source: R. Featherstone, Rigid
Body Dynamics Algorithms (2008), table 5.1.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from trueup.model.tree import ARMATURE, FRAME, GRAVITY, JOINT, LINK, PARENT, SLIDE, ZERO, Tree

Array = NDArray[np.float64]


def mass_matrix(tree: Tree, q: Array) -> Array:
    """Mass matrices at positions `(n, joints)`, armatures included, `(n, joints, joints)`."""
    return np.stack(
        [
            inverse_dynamics(tree, q, np.zeros_like(q), np.zeros_like(q) + axis, gravity=False)
            for axis in np.eye(q.shape[1])
        ],
        2,
    )


def inverse_dynamics(tree: Tree, q: Array, v: Array, a: Array, *, gravity: bool = True) -> Array:
    """Force at each joint `(n, joints)` that links and armatures need for accelerations `a`; no
    damping, spring or friction."""
    links, at_joint = np.split(np.array(tree.parameters), [LINK * q.shape[1]])
    return np.asarray(
        regressors(tree, q, v, a, gravity=gravity) @ links + a * at_joint[ARMATURE::JOINT]
    )


def regressors(tree: Tree, q: Array, v: Array, a: Array, *, gravity: bool = True) -> Array:
    """The factor of each inertial number in the force at each joint, `(n, joints, 10 joints)`.

    Recursive Newton-Euler on arrays: the compiled rollout's reference. Source: R. Featherstone
    (2008), table 5.1.
    """
    n, joints = q.shape
    turn, origin = np.empty((joints, n, 3, 3)), np.empty((joints, n, 3))
    spin, gain, pull = (np.zeros((joints, n, 3)) for _ in range(3))
    factor = np.zeros((n, joints, LINK * joints))
    z = np.array([0.0, 0.0, 1.0])
    for j, c in enumerate(tree.constants):
        parent, slides, moved = int(c[PARENT]), c[SLIDE] > 0.0, q[:, j] - c[ZERO]
        angle, along = (np.zeros(n), moved) if slides else (moved, np.zeros(n))
        base, place = c[FRAME : FRAME + 9].reshape(3, 3).T, c[FRAME + 9 : ZERO]
        cosine, sine, one, nil = np.cos(angle), np.sin(angle), np.ones(n), np.zeros(n)
        about = np.stack(
            [
                np.stack([cosine, -sine, nil], 1),
                np.stack([sine, cosine, nil], 1),
                np.stack([nil, nil, one], 1),
            ],
            1,
        )
        turn[j] = base @ about
        origin[j] = place + along[:, None] * base[:, 2]
        w, e, g = (
            (spin[parent], gain[parent], pull[parent])
            if parent >= 0
            else (nil[:, None] * z, nil[:, None] * z, -c[GRAVITY:] * gravity)
        )
        at = g + np.cross(e, origin[j]) + np.cross(w, np.cross(w, origin[j]))
        w, e, at = (
            np.einsum("nji,nj->ni", turn[j], np.broadcast_to(x, (n, 3))) for x in (w, e, at)
        )
        speed, faster = v[:, j, None] * z, a[:, j, None] * z
        if slides:
            spin[j], gain[j], pull[j] = w, e, at + 2.0 * np.cross(w, speed) + faster
        else:
            spin[j], gain[j], pull[j] = w + speed, e + np.cross(w, speed) + faster, at
        moment = _wrench(spin[j], gain[j], pull[j])  # (n, 6, 10)
        to = j
        while to >= 0:
            factor[:, to, LINK * j : LINK * (j + 1)] = moment[
                :, 2 if tree.constants[to, SLIDE] > 0.0 else 5
            ]
            force, torque = turn[to] @ moment[:, :3], turn[to] @ moment[:, 3:]
            moment = np.concatenate(
                [
                    force,
                    torque + np.cross(origin[to][:, None], np.swapaxes(force, 1, 2)).swapaxes(1, 2),
                ],
                axis=1,
            )
            to = int(tree.constants[to, PARENT])
    return factor


def _wrench(w: Array, e: Array, a: Array) -> Array:
    """Force and moment on a link by each of its ten inertial numbers, `(n, 6, 10)`."""
    n = len(w)
    wrench = np.zeros((n, 6, LINK))
    wrench[:, :3, 0] = a
    skew = _skew(e) + _skew(w) @ _skew(w)
    wrench[:, :3, 1:4] = skew
    wrench[:, 3:, 1:4] = -_skew(a)
    wrench[:, 3:, 4:] = _dot(e) + _skew(w) @ _dot(w)
    return wrench


def _skew(x: Array) -> Array:
    nil = np.zeros(len(x))
    rows = [[nil, -x[:, 2], x[:, 1]], [x[:, 2], nil, -x[:, 0]], [-x[:, 1], x[:, 0], nil]]
    return np.stack([np.stack(r, 1) for r in rows], 1)


def _dot(x: Array) -> Array:
    """The matrix that takes second moments (xx, yy, zz, xy, xz, yz) to the inertia times `x`, `(n,
    3, 6)`."""
    nil = np.zeros(len(x))
    p, q, r = x.T
    rows = [[p, nil, nil, q, r, nil], [nil, q, nil, p, nil, r], [nil, nil, r, nil, p, q]]
    return np.stack([np.stack(r, 1) for r in rows], 1)
