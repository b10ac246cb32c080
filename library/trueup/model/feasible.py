"""Feasible: masses that bodies can have, among all that move alike.

What a robot's motion shows are combinations of its links' numbers; many sets of links share them,
and the set that a fit ends with may hold a link of negative mass, or one whose moments of inertia
no body has. The nearest set of possible links that moves the same way is found by projecting onto
one condition after the other: the same combinations, and of each link a pseudo-inertia matrix
without negative eigenvalues. Source: P. M. Wensing, S. Kim, J.-J. Slotine, IEEE Robotics and
Automation Letters 3 (2018), for the matrix; H. H. Bauschke, J. M. Borwein, SIAM Review 38 (1996),
for the projections.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from trueup.model.tree import ARMATURE, FRAME, JOINT, LINK, ZERO, Tree
from trueup.model.tree_regressors import inverse_dynamics, regressors

Array = NDArray[np.float64]
MOMENTS = 60  # of random motion for each joint: more combinations than that there are not
SHOWN = 1e-9  # of the largest singular value
LEAST = 1e-4  # of a usual link: an eigenvalue
ROUNDS = 4000
NEAR = 1e-7  # of the forces: the same motion
SEED = 1


def feasible(tree: Tree) -> tuple[Tree, float]:
    """The nearest robot whose links can exist and that moves as this one does, and how far its
    forces are off, as a part of them.

    Links and armatures change, nothing else. Links of joints that share a body with the next stay
    without mass.
    """
    joints = len(tree.joints)
    numbers = np.array(tree.parameters)
    moving = np.concatenate(
        [np.arange(LINK * joints), LINK * joints + JOINT * np.arange(joints) + ARMATURE]
    )
    size = _sizes(tree)
    wanted = numbers[moving] / size
    q, v, a = np.random.default_rng(SEED).normal(size=(3, MOMENTS * joints, joints))
    design = (
        np.concatenate([regressors(tree, q, v, a), a[:, :, None] * np.eye(joints)], axis=2).reshape(
            -1, len(moving)
        )
        * size
    )
    _, singular, ways = np.linalg.svd(design, full_matrices=False)
    shown = ways[singular > SHOWN * singular[0]]
    near = np.linalg.inv(_metric(joints))
    back = near @ shown.T @ np.linalg.inv(shown @ near @ shown.T)
    now = wanted
    for _ in range(ROUNDS):
        now = _possible(now, tree)
        missing = shown @ (wanted - now)
        if float(np.abs(missing).max()) < NEAR:
            break
        now = now + back @ missing
    now = _possible(now, tree)
    numbers[moving] = now * size
    nearest = replace(tree, parameters=tuple(float(x) for x in numbers))
    needed, given = inverse_dynamics(tree, q, v, a), inverse_dynamics(nearest, q, v, a)
    return nearest, float(
        np.linalg.norm(given - needed) / max(float(np.linalg.norm(needed)), 1e-300)
    )


def _sizes(tree: Tree) -> Array:
    """Units in which the numbers of a usual link are about 1."""
    joints = len(tree.joints)
    mass = float(
        np.mean(np.abs(np.array(tree.parameters)[: LINK * joints].reshape(-1, LINK)[:, 0]))
    )
    length = float(np.mean(np.linalg.norm(tree.constants[:, FRAME + 9 : ZERO], axis=1))) or 0.1
    link = [mass, *[mass * length] * 3, *[mass * length**2] * 6]
    return np.concatenate([np.tile(link, joints), np.full(joints, mass * length**2)])


def _possible(now: Array, tree: Tree) -> Array:
    """The nearest links that can exist, in units of a usual one."""
    joints = len(tree.joints)
    after = now.copy()
    for j in range(joints):
        at = slice(LINK * j, LINK * (j + 1))
        if not any(tree.parameters[at]):  # no body of its own
            after[at] = 0.0
            continue
        values, axes = np.linalg.eigh(_pseudo(now[at]))
        if values[0] < LEAST:
            after[at] = _numbers((axes * np.maximum(values, 2.0 * LEAST)) @ axes.T)
    after[LINK * joints :] = np.maximum(now[LINK * joints :], 0.0)
    return after


def _metric(joints: int) -> Array:
    """What both projections are nearest in, lest they drive each other away: the squared norm of
    each pseudo-inertia, and of armatures."""
    flat = np.stack([_pseudo(e).reshape(-1) for e in np.eye(LINK)])
    metric = np.eye((LINK + 1) * joints)
    for j in range(joints):
        metric[LINK * j : LINK * (j + 1), LINK * j : LINK * (j + 1)] = flat @ flat.T
    return metric


def _pseudo(link: Array) -> Array:
    """Ten inertial numbers as second moments of the mass, `(4, 4)`."""
    x, y, z = link[4:7]
    pseudo = np.empty((4, 4))
    pseudo[:3, :3] = [
        [0.5 * (y + z - x), -link[7], -link[8]],
        [-link[7], 0.5 * (x + z - y), -link[9]],
        [-link[8], -link[9], 0.5 * (x + y - z)],
    ]
    pseudo[3, :3] = pseudo[:3, 3] = link[1:4]
    pseudo[3, 3] = link[0]
    return pseudo


def _numbers(pseudo: Array) -> Array:
    """The ten numbers again."""
    s = pseudo[:3, :3]
    x, y, z = np.diag(s)
    return np.array(
        [pseudo[3, 3], *pseudo[3, :3], y + z, x + z, x + y, -s[0, 1], -s[0, 2], -s[1, 2]]
    )
