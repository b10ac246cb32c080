"""Coverage: does an episode stay where a model has been fitted? For each joint, its position,
velocity and applied command are compared.

    box      inside the range of each of the three by itself, as recorded when the model was fitted
             (the sample box)
    hull     inside the convex hull of what was recorded: corners of the box that were never visited
             are outside
    density  near enough to a recorded sample: a hole inside the hull is outside

The declared envelope and limits are another box, of what may be visited; an episode can be inside
that and outside all of these.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls
from scipy.spatial import ConvexHull, KDTree

from trueup.canonical import Json
from trueup.episode.episode import Episode
from trueup.model.plant import Plant
from trueup.model.state import smoothed_states

Array = NDArray[np.float64]
SAMPLES = 160  # of what was recorded, kept for the density
ASKED = 240  # samples of an episode that are looked at
TOUCH = 0.02  # of a range: as near to the hull's faces is inside
NEAR = 0.99  # of the recorded samples are as near to a kept one
WARNED = 0.05  # of an episode outside: worth a warning
LEAST = 1e-12  # of a range, to divide by
HAIR = 1e-6  # of a range: thinner is flat
DIGITS = 6  # of the numbers that are kept
GRID = 0.004  # of a range: points are rounded to it before their hull, which keeps its corners few
WHOLE = 1e3  # by so much the parts of a mixture must add up to one


@dataclass(frozen=True, slots=True, eq=False)
class Coverage:
    """The region of one joint's recorded motion: ranges `(3,)`, corners of the hull `(corners, 3)`,
    samples `(samples, 3)`, and the distance `near` that counts as near.

    Corners and samples are in units of the ranges, from 0 to 1.
    """

    joint: str
    low: Array
    high: Array
    corners: Array
    samples: Array
    near: float

    def outside(self, triples: Array) -> dict[str, float]:
        """The share of samples `(n, 3)` that is outside the box, the hull, and the density."""
        x = (triples - self.low) / np.maximum(self.high - self.low, LEAST)
        beyond = ((x < -TOUCH) | (x > 1.0 + TOUCH)).any(axis=1)
        off = beyond | (_Hull.of(self.corners).away(x) > TOUCH)
        return {
            "box": float(beyond.mean()),
            "hull": float(off.mean()),
            "density": float((KDTree(self.samples).query(x)[0] > self.near).mean()),
        }

    def document(self) -> dict[str, Json]:
        """The coverage as JSON."""
        rows = {
            name: [[round(float(x), DIGITS) for x in row] for row in getattr(self, name)]
            for name in ("corners", "samples")
        }
        ranges: dict[str, Json] = {
            name: [float(x) for x in getattr(self, name)] for name in ("low", "high")
        }
        return {"joint": self.joint, **ranges, **rows, "near": self.near}

    @staticmethod
    def from_document(document: Mapping[str, Any]) -> Coverage:
        """Read what `document` returned. Raises KeyError, TypeError, ValueError."""
        low, high, corners, samples = (
            np.array(document[name], np.float64) for name in ("low", "high", "corners", "samples")
        )
        return Coverage(
            str(document["joint"]), low, high, corners, samples, float(document["near"])
        )


def coverage_of(plant: Plant, episodes: Sequence[Episode]) -> list[Coverage]:
    """The coverage of each joint in the episodes that a model is fitted on."""
    coverages = []
    for joint in range(len(plant.joints)):
        triples = np.concatenate([_triples(plant, e, joint) for e in episodes])
        low, high = triples.min(axis=0), triples.max(axis=0)
        x = (triples - low) / np.maximum(high - low, LEAST)
        corners = _Hull.of(np.round(x / GRID) * GRID).corners
        chosen = x[:: -(-len(x) // SAMPLES)]
        # as far from chosen ones as samples can be
        between = x[len(x) // (2 * SAMPLES) :: -(-len(x) // SAMPLES)]
        near = float(np.quantile(KDTree(chosen).query(between)[0], NEAR)) + TOUCH
        coverages.append(Coverage(plant.joint_name(joint), low, high, corners, chosen, near))
    return coverages


def compared(
    plant: Plant, episode: Episode, fitted_on: Sequence[Coverage], warnings: list[str]
) -> dict[str, Json]:
    """For each joint, the share of the episode outside the coverage of a model's fit. What deserves
    a warning is added to `warnings` in words."""
    outside: dict[str, Json] = {}
    for joint, been in enumerate(fitted_on):
        triples = _triples(plant, episode, joint)
        shares = been.outside(triples[:: -(-len(triples) // ASKED)])
        outside[been.joint] = {**shares}
        if shares["hull"] > WARNED:
            warnings.append(
                f"{100 * shares['hull']:.0f} % of {been.joint} lies outside of what the "
                "serving model was fitted on (convex hull of "
                f"position, velocity and command; {100 * shares['box']:.0f} % outside of "
                "its ranges)"
            )
    return outside


def _triples(plant: Plant, episode: Episode, joint: int) -> Array:
    states = smoothed_states(plant, episode)
    rows = np.column_stack(
        [
            states[:, joint],
            states[:, len(plant.joints) + joint],
            plant.applied(episode.commands)[:, joint],
        ]
    )
    return np.asarray(rows[np.isfinite(rows).all(axis=1)])


@dataclass(frozen=True, slots=True, eq=False)
class _Hull:
    """The convex hull of points: corners `(corners, 3)`, and faces `(faces, 4)` whose product with
    (point, 1) is how far beyond the face a point is."""

    corners: Array
    faces: Array

    @staticmethod
    def of(points: Array) -> _Hull:
        """The hull of points `(n, 3)`. They may lie in a plane or on a line, as where a joint
        stood still."""
        points = np.unique(points, axis=0)
        middle = points.mean(axis=0)
        axes = np.linalg.svd(points - middle, full_matrices=False)[2]
        thick = np.ptp((points - middle) @ axes.T, axis=0) > HAIR
        inside, across = (points - middle) @ axes[thick].T, axes[~thick]
        if thick.sum() > 1:
            hull = ConvexHull(inside)
            ends, faces = hull.vertices, hull.equations
        else:
            ends = np.unique([inside.sum(axis=1).argmin(), inside.sum(axis=1).argmax()])
            faces = np.array([[1.0, -inside.max(initial=0.0)], [-1.0, inside.min(initial=0.0)]])
            faces = faces if thick.any() else faces[:, 1:]
        normals = np.concatenate([faces[:, :-1] @ axes[thick], across, -across])
        off = np.append(faces[:, -1], np.zeros(2 * len(across))) - normals @ middle
        return _Hull(points[ends], np.column_stack([normals, off]))

    def away(self, x: Array) -> Array:
        """Distance of points `(n, 3)` from the hull, `(n,)`, no more than 0 inside. Beyond TOUCH it
        is that from the plane of a face, which is no larger."""
        away = np.asarray((x @ self.faces[:, :3].T + self.faces[:, 3]).max(axis=1))
        mixed = np.vstack([self.corners.T, np.full(len(self.corners), WHOLE)])
        for i in np.flatnonzero((away > 0.0) & (away <= TOUCH)):
            # beyond a sharp edge the planes of both faces are nearer than the edge
            away[i] = nnls(mixed, np.append(x[i], WHOLE))[1]
        return away
