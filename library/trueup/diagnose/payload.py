"""Payload: whether the change of a robot's inertial numbers is that of one mass on one link.

A log shows combinations of inertial numbers, so a mass on a link moves several of them together,
and may look the same on another link. For every link the mass and its centre are sought whose
combinations, and armatures, come nearest to those that were fitted, in the metric of their
covariance; links whose masses come about as near are told together.

Source: M. Gautier, Journal of Robotic Systems 8 (1991), for the combinations; W. Khalil, E. Dombre,
Modeling, Identification and Control of Robots (2002), section 12.8, for payloads.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import singledispatch

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.special import chdtrc

from trueup.canonical import Json
from trueup.diagnose.candidate import Candidate
from trueup.diagnose.intervals import covariance
from trueup.diagnose.tuning_of_answers import PAYLOAD
from trueup.episode.episode import Episode
from trueup.fit.base_parameters import regression
from trueup.fit.free_numbers import Directions
from trueup.fit.rollout_fit import TWO_SIDED
from trueup.model.dynamics import CompiledTree, Dynamics
from trueup.model.plant import Plant
from trueup.model.tree import ARMATURE, FRAME, JOINT, LINK, PARENT, ZERO, Tree

Array = NDArray[np.float64]
UNKNOWNS = 4  # a mass, and its centre
RIDGE = 1e-9  # of a variance; and of the largest way: less is rounding
BEGIN = 0.3  # of the heaviest link: from where a mass is sought


@dataclass(frozen=True, slots=True)
class Payload:
    """A mass [kg] with its half-width at 95 %, and its centre [m] from the joint of the nearest
    link, None along axes on which the recordings do not show it.

    `links` are those on which it would look the same, the nearest first. `axes` are those of the
    centre's coordinates, the last along the joint, in the robot's base at its zero position.
    `explains` is the part of the change of the numbers that it is.
    """

    links: tuple[str, ...]
    mass_kg: float
    within_kg: float
    centre_m: tuple[float | None, float | None, float | None]
    axes: tuple[tuple[float, ...], ...]
    explains: float

    def document(self) -> dict[str, Json]:
        """The payload as JSON, a field of the report."""
        low = max(self.mass_kg - self.within_kg, 0.0)
        return {
            "links": list(self.links),
            "mass": {
                "value": self.mass_kg,
                "unit": "kg",
                "ci95": [low, self.mass_kg + self.within_kg],
            },
            "centre": {
                "value": list(self.centre_m),
                "unit": "m",
                "axes": [list(axis) for axis in self.axes],
            },
            "explains": self.explains,
        }


@dataclass(frozen=True, slots=True)
class _Mass:
    """A mass and its first moments `x` `(4,)` on one link, the squared distance that it leaves, and
    how that changes `(directions, 4)`, all in `unit` `(4,)`."""

    cost: float
    x: Array
    changes: Array
    unit: Array

    @property
    def mass_kg(self) -> float:
        """The mass [kg]."""
        return float(self.x[0] * self.unit[0])

    def centre_m(self, within_m: Array) -> tuple[float | None, float | None, float | None]:
        """Its centre [m]; None along an axis on which the recordings do not show it, by half of
        each 95 % interval `(3,)` [m]."""
        centre = self.x[1:] * self.unit[1:] / self.mass_kg
        length = self.unit[1] / self.unit[0]
        x, y, z = (
            float(c) if w < PAYLOAD.shown * length else None
            for c, w in zip(centre, within_m, strict=True)
        )
        return x, y, z

    def within(self, free: int) -> tuple[float, Array]:
        """Half of the 95 % intervals of the mass [kg] and of its centre `(3,)` [m], by so many
        numbers more than unknowns."""
        scale = max(self.cost / free, 1.0)
        ridge = RIDGE * np.trace(self.changes.T @ self.changes) * np.eye(UNKNOWNS)
        spread = np.linalg.inv(self.changes.T @ self.changes + ridge) * scale
        moments = self.x[1:] / self.x[0]
        by_centre = np.hstack([-moments[:, None], np.eye(3)]) / self.x[0]
        centre = np.sqrt(np.einsum("ci,ij,cj->c", by_centre, spread, by_centre))
        mass = float(np.sqrt(spread[0, 0]))
        length = self.unit[1] / self.unit[0]
        return TWO_SIDED * mass * float(self.unit[0]), TWO_SIDED * centre * length


def payload(
    plant: Plant, directions: Directions, fitted: Candidate, episodes: Sequence[Episode]
) -> Payload | None:
    """The payload that a fit's numbers are, beside the nominal ones; None where they are none, or
    where the plant is no robot."""
    return _payload(plant.dynamics, plant, directions, fitted, episodes)


@singledispatch
def _payload(
    _: Dynamics,
    plant: Plant,
    directions: Directions,
    fitted: Candidate,
    episodes: Sequence[Episode],
) -> Payload | None:
    return None


@_payload.register
def _of_tree(
    dynamics: CompiledTree,
    plant: Plant,
    directions: Directions,
    fitted: Candidate,
    episodes: Sequence[Episode],
) -> Payload | None:
    tree, joints = dynamics.tree, len(plant.joints)
    weighs = _weighs(directions, joints)
    if weighs.sum() <= UNKNOWNS:
        return None
    moved, spread = _moved(plant, directions, fitted, weighs)
    shown = _shown(plant, directions, episodes)[weighs]
    whiten = np.linalg.inv(np.linalg.cholesky(spread))
    seen = whiten @ moved
    masses = [
        _mass_on(whiten @ shown[:, LINK * link : LINK * (link + 1)], seen, tree)
        for link in range(joints)
    ]
    order = sorted(range(joints), key=lambda i: masses[i].cost)
    best, free = masses[order[0]], len(seen) - UNKNOWNS
    explains = 1.0 - best.cost / max(float(seen @ seen), 1e-300)
    by_chance = float(chdtrc(free, best.cost))
    within_kg, within_m = best.within(free)
    if explains < PAYLOAD.explains or best.mass_kg <= within_kg:
        return None
    if by_chance < PAYLOAD.least_probable and explains < PAYLOAD.nearly_all:
        return None
    limit = best.cost + PAYLOAD.alike * max(best.cost / free, 1.0)
    links = tuple(plant.joint_name(i) for i in order if masses[i].cost <= limit)
    axes = tuple(tuple(float(x) for x in axis) for axis in _axes(tree, order[0]))
    return Payload(links, best.mass_kg, within_kg, best.centre_m(within_m), axes, explains)


def _weighs(directions: Directions, joints: int) -> NDArray[np.bool_]:
    """Which directions a mass may move: combinations and armatures, `(directions,)`."""
    first = LINK * joints
    at_joint = directions.alone - first
    return np.asarray((directions.alone < 0) | ((at_joint >= 0) & (at_joint % JOINT == ARMATURE)))


def _moved(
    plant: Plant, directions: Directions, fitted: Candidate, weighs: NDArray[np.bool_]
) -> tuple[Array, Array]:
    """How far those directions were moved from the nominal numbers, `(directions,)`, and their
    covariance."""
    count = len(directions.names)
    change = fitted.fit.values[: len(plant.parameters)] - np.array(plant.parameters)
    size = np.linalg.norm(directions.along, axis=0)
    moves = size > RIDGE * size.max()
    along = directions.along[:, moves] / size[moves]
    moved = np.linalg.lstsq(along.T, change[moves] / size[moves], rcond=None)[0]
    spread = covariance(fitted.fit)[:count, :count][np.ix_(weighs, weighs)]
    spread = spread + RIDGE * np.diag(np.diag(spread)) + 1e-300 * np.eye(int(weighs.sum()))
    return moved[weighs], spread


def _shown(plant: Plant, directions: Directions, episodes: Sequence[Episode]) -> Array:
    """What a change of each number looks like along the directions, `(directions, parameters)`:
    that which adds the same forces to the recorded motion."""
    shows, force = regression(plant, episodes)
    scale = np.maximum(np.sqrt(np.mean(force**2, axis=0)), 1e-9)
    design = (shows / scale[None, :, None]).reshape(-1, shows.shape[2])
    return np.asarray(np.linalg.lstsq(design @ directions.along.T, design, rcond=None)[0])


def _mass_on(columns: Array, moved: Array, tree: Tree) -> _Mass:
    """The mass on one link whose columns `(directions, LINK)` come nearest to what moved
    `(directions,)`."""
    length = float(np.max(np.linalg.norm(tree.constants[:, FRAME + 9 : ZERO], axis=1))) or 0.1
    heaviest = float(np.max(tree.links[:, 0])) or 1.0
    unit = np.array([heaviest, *[heaviest * length] * 3])
    low = [PAYLOAD.lightest, *[-PAYLOAD.heaviest] * 3]

    def left(x: Array) -> Array:
        return np.asarray(columns @ _point(x * unit) - moved)

    begins = [np.zeros(3), *np.eye(3), *-np.eye(3)]
    solved = [
        least_squares(left, [BEGIN, *(BEGIN * at)], bounds=(low, [PAYLOAD.heaviest] * UNKNOWNS))
        for at in begins
    ]
    best = min(solved, key=lambda s: float(s.cost))
    return _Mass(2.0 * float(best.cost), best.x, best.jac, unit)


def _axes(tree: Tree, link: int) -> Array:
    """A link's axes in the robot's base at its zero position, a row each, `(3, 3)`."""
    constants = tree.constants[link]
    own = constants[FRAME : FRAME + 9].reshape(3, 3)
    parent = int(constants[PARENT])
    return np.asarray(own if parent < 0 else own @ _axes(tree, parent))


def _point(x: Array) -> Array:
    """The ten inertial numbers `(LINK,)` of a point mass by its mass and first moments `(4,)`."""
    mass, moments = x[0], x[1:]
    second = (float(moments @ moments) * np.eye(3) - np.outer(moments, moments)) / mass
    return np.concatenate([x, np.diag(second), [second[0, 1], second[0, 2], second[1, 2]]])
