"""Base parameters: the combinations of a robot's numbers that its recorded motion shows.

Where everything weighs more and every actuator is stronger by the same part, nothing moves
differently: the mean gain stays as declared. A link's mass and moments reach the joints in fewer
combinations than there are numbers, and a log shows fewer still. The force that a number adds at
each joint, sample by sample, is its column; the singular vectors of all columns, each number
measured by its own size, are the combinations, and those that hardly change any force are left
where the nominal model has them. Source: M. Gautier, Journal of Robotic Systems 8 (1991), numerical
base parameters; W. Khalil, E. Dombre, Modeling, Identification and Control of Robots (2002),
section 12.5.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import singledispatch

import numpy as np
from numpy.typing import NDArray

from trueup.episode.episode import Episode, is_physical
from trueup.fit.free_numbers import STEP, Directions
from trueup.model.dynamics import CompiledTree, Dynamics
from trueup.model.plant import Plant
from trueup.model.rounding import GUESS_BITS, rounded
from trueup.model.simulator.dynamics import SimulatedDynamics
from trueup.model.state import smoothed_states
from trueup.model.tree import (
    ARMATURE,
    DAMPING,
    FRAME,
    FRICTION,
    GAIN,
    JOINT,
    LINK,
    REST,
    SERVO,
    STIFFNESS,
    ZERO,
    Tree,
)
from trueup.model.tree_regressors import mass_matrix, regressors

Array = NDArray[np.float64]
# over which an acceleration is a mean: short against the motion, long against the noise of a
# velocity
SPAN_S = 0.05
MOST_ROWS = 4000
FELT = 2e-3  # of the forces: a combination that moves them less by its own size is not shown
FELT_ON_MACHINE = 5e-2  # the same where no law is much more exact than that
SHOWN_BESIDE = 1e-4  # of what a simulator's number does: less is what those before it do
POSES = 50  # of an episode are looked at
LIGHTEST = 0.9  # of what a joint's links weigh may be missing from its inertia
COMBINATION = "combination"  # what is shown of several numbers together, with its number
ALONE = 0.999  # of a number lies in the combinations that are shown: it is determined by itself


def directions(plant: Plant, episodes: Sequence[Episode]) -> Directions:
    """The directions in which a plant's numbers may move: a family's one by one, a tree's as
    combinations that the episodes show."""
    return _directions(plant.dynamics, plant, episodes)


@singledispatch
def _directions(dynamics: Dynamics, plant: Plant, episodes: Sequence[Episode]) -> Directions:
    return Directions.of_family(dynamics.parameter_names)


@_directions.register
def _of_simulator(
    dynamics: SimulatedDynamics, plant: Plant, episodes: Sequence[Episode]
) -> Directions:
    """A simulator's numbers by themselves, as far as the motion shows them: of those that show only
    together, as an inertia and all that acts on it, the last by name stays as declared."""
    numbers = np.array(plant.parameters)
    size = np.where(numbers != 0.0, np.abs(numbers), 1.0)
    moments = [_moments(plant, e) for e in episodes]
    q, v, _, u = (np.concatenate(m) for m in zip(*moments, strict=True))
    every = -(-len(q) // MOST_ROWS)
    states = np.column_stack([q, v])[::every]
    slopes = dynamics.slopes(numbers, states, u[::every])
    design = slopes.reshape(-1, len(numbers)) * size
    left, alone = design.copy(), list[int]()
    for i in range(len(numbers)):
        length = np.linalg.norm(left[:, i])
        if length > SHOWN_BESIDE * np.linalg.norm(design[:, i]):
            alone.append(i)
            way = left[:, i] / length
            left = left - np.outer(way, way @ left)
    return Directions(
        tuple(dynamics.parameter_names[i] for i in alone),
        along=np.eye(len(numbers))[alone],
        determined=np.isin(np.arange(len(numbers)), alone),
        alone=np.array(alone, np.int64),
        steps=STEP * size[alone],
        low=np.full(len(alone), -np.inf),
        nominal=np.zeros(len(numbers)),
    )


@_directions.register
def _of_tree(dynamics: CompiledTree, plant: Plant, episodes: Sequence[Episode]) -> Directions:
    shows, force = regression(plant, episodes)
    size = sizes(dynamics.tree, plant.form.sizes)
    scale = np.maximum(np.sqrt(np.mean(force**2, axis=0)), 1e-9)
    design = (shows / scale[None, :, None]).reshape(-1, shows.shape[2]) * size
    design = design - design @ np.outer(together := _all_gains(plant, size), together)
    design /= np.sqrt(len(shows))
    felt = FELT_ON_MACHINE if is_physical(episodes) else FELT
    single, low = _single(dynamics.tree, plant, episodes)
    alone = np.flatnonzero((np.linalg.norm(design, axis=0) > felt) & single)
    by_themselves, shown = design[:, alone], _shown(design, felt)
    combined = _shown(
        np.where(
            single,
            0.0,
            design - by_themselves @ np.linalg.lstsq(by_themselves, design, rcond=None)[0],
        ),
        felt,
    )
    names = [f"{COMBINATION} {i + 1}" for i in range(len(combined))] + [
        plant.dynamics.parameter_names[i] for i in alone
    ]
    return Directions(
        tuple(names),
        along=np.concatenate([combined * size, np.eye(len(size))[alone]]),
        determined=(np.einsum("kp,kp->p", shown, shown) > ALONE) & (size > 0.0),
        alone=np.concatenate([np.full(len(combined), -1), alone]),
        steps=STEP * np.concatenate([np.ones(len(combined)), size[alone]]),
        low=np.concatenate([np.full(len(combined), -np.inf), low[alone]]),
        nominal=np.array(plant.parameters),
    )


def _shown(design: Array, felt: float) -> Array:
    """The ways along which a design moves by more than `felt`, `(ways, parameters)`."""
    _, singular, ways = np.linalg.svd(design, full_matrices=False)
    shown = ways[singular > felt]
    largest = np.take_along_axis(shown, np.abs(rounded(shown)).argmax(axis=1)[:, None], axis=1)
    # a singular vector's sign is nobody's
    return np.asarray(rounded(shown * np.sign(largest), GUESS_BITS))


def _single(
    tree: Tree, plant: Plant, episodes: Sequence[Episode]
) -> tuple[NDArray[np.bool_], Array]:
    """Which numbers move by themselves, and the least that each may be, `(parameters,)`: damping
    and friction, which are not negative, and armature, which leaves something of what a joint's
    links weigh.
    """
    first = LINK * len(plant.joints)
    single, low = np.zeros(len(plant.parameters), np.bool_), np.zeros(len(plant.parameters))
    for number in (ARMATURE, DAMPING, FRICTION):
        single[first + number :: JOINT] = True
    masses = np.einsum("njj->nj", mass_matrix(tree, recorded_poses(plant, episodes)))
    given = np.array(plant.parameters)[first + ARMATURE :: JOINT]
    low[first + ARMATURE :: JOINT] = -LIGHTEST * (masses.min(axis=0) - given)
    return single, low


def _all_gains(plant: Plant, size: Array) -> Array:
    """The way in which all actuators grow alike, which with all masses no motion shows,
    `(parameters,)`, of length 1."""
    first, joints = LINK * len(plant.joints), len(plant.joints)
    way = np.zeros(len(size))
    gains = first + JOINT * np.arange(joints) + GAIN
    way[gains] = np.where(size[gains] > 0.0, np.sign(np.array(plant.parameters)[gains]), 0.0)
    return np.asarray(way / max(float(np.linalg.norm(way)), 1e-300))


def sizes(tree: Tree, inertia: Array) -> Array:
    """By how much each number of a tree may be expected to be off, `(parameters,)`; 0 for those
    that stay as they are. `inertia` `(joints,)` is each joint's own."""
    joints, given = len(tree.joints), np.array(tree.parameters)
    mass = float(np.mean(given[: LINK * joints].reshape(-1, LINK)[:, 0]))
    length = float(np.mean(np.linalg.norm(tree.constants[:, FRAME + 9 : ZERO], axis=1))) or 0.1
    link = [mass, *[mass * length] * 3, *[mass * length**2] * 6]
    size = np.concatenate([np.tile(link, joints), np.zeros(JOINT * joints)])
    for j in range(joints):
        at = given[LINK * joints + JOINT * j :][:JOINT]
        own = inertia[j]
        to = size[LINK * joints + JOINT * j :]
        to[ARMATURE] = max(at[ARMATURE], 0.1 * own)
        to[DAMPING] = max(at[DAMPING], own)  # a joint whose speed would halve in about a second
        to[GAIN], to[SERVO], to[STIFFNESS], to[FRICTION] = (
            abs(at[GAIN]),
            abs(at[SERVO]),
            abs(at[STIFFNESS]),
            abs(at[FRICTION]),
        )
    return size


def regression(plant: Plant, episodes: Sequence[Episode]) -> tuple[Array, Array]:
    """What each number adds to the force that is missing at each joint, `(rows, joints,
    parameters)`, and the forces `(rows, joints)` that links and armatures need, at moments of
    recorded episodes.
    """
    moments = [_moments(plant, e) for e in episodes]
    every = -(-sum(len(m[0]) for m in moments) // MOST_ROWS)
    q, v, a, u = (np.concatenate([m[i] for m in moments])[::every] for i in range(4))
    return columns(plant, q, v, a, u)


def recorded_poses(plant: Plant, episodes: Sequence[Episode]) -> Array:
    """Joint positions that were recorded, about `POSES` of each episode, `(poses, joints)`."""
    poses = np.concatenate(
        [
            smoothed_states(plant, e)[:: max(1, len(e.t_s) // POSES), : len(plant.joints)]
            for e in episodes
        ]
    )
    return np.asarray(poses[np.isfinite(poses).all(axis=1)])


def columns(plant: Plant, q: Array, v: Array, a: Array, u: Array) -> tuple[Array, Array]:
    """What each number adds to the missing force, and the forces, as `regression` gives them, at
    positions, velocities, accelerations and commands `(rows, joints)` each of a robot."""
    tree, joints = plant.tree, len(plant.joints)
    inertial = regressors(tree, q, v, a)
    at_joint = np.zeros((len(q), joints, JOINT * joints))
    for j in range(joints):
        own = at_joint[:, j, JOINT * j : JOINT * (j + 1)]
        own[:, ARMATURE], own[:, DAMPING] = a[:, j], v[:, j]
        own[:, GAIN], own[:, SERVO] = -u[:, j], q[:, j]
        own[:, STIFFNESS], own[:, FRICTION] = q[:, j] - tree.constants[j, REST], np.sign(v[:, j])
    links, rest = np.split(np.array(tree.parameters), [LINK * joints])
    needed = inertial @ links + a * rest[ARMATURE::JOINT]
    return np.concatenate([inertial, at_joint], axis=2), needed


def _moments(plant: Plant, episode: Episode) -> tuple[Array, Array, Array, Array]:
    """Positions, velocities, mean accelerations and mean commands over spans, `(spans, joints)`
    each."""
    joints = len(plant.joints)
    states = smoothed_states(plant, episode)
    span = (
        max(2, round(SPAN_S / episode.period_s))
        if len(episode.t_s) > 2 * round(SPAN_S / episode.period_s) + 2
        else 1
    )
    first, last = np.arange(len(states) - span), np.arange(span, len(states))
    h = (episode.t_s[last] - episode.t_s[first])[:, None]
    applied = plant.applied(episode.commands)
    issued = np.concatenate(
        [np.zeros((1, joints)), np.cumsum(applied[:-1] * np.diff(episode.t_s)[:, None], axis=0)]
    )
    a = (states[last, joints:] - states[first, joints:]) / h
    middle = states[first + span // 2]
    q, v, u = middle[:, :joints], middle[:, joints:], (issued[last] - issued[first]) / h
    known = np.isfinite(np.concatenate([q, v, a, u], axis=1)).all(axis=1)
    return q[known], v[known], a[known], u[known]
