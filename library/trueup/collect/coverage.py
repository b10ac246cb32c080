"""Coverage: does an episode stay where a model has been fitted? For each joint, its position,
velocity and applied command are compared.

    box      inside the range of each of the three by itself, as recorded when the model was fitted
             (the sample box)
    hull     inside the convex hull of what was recorded: corners of the box that were never visited
             are outside
    density  near enough to a recorded sample: a hole inside the hull is outside

The declared envelope and limits are another box, of what may be visited; an episode can be inside
that and outside all of these. Source: membership by conditional gradients: M. Frank, P. Wolfe,
Naval Research Logistics Quarterly 3 (1956).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trueup.canonical import Json
from trueup.episode.episode import Episode
from trueup.model.plant import Plant
from trueup.model.state import smoothed_states

Array = NDArray[np.float64]
DIRECTIONS = 160  # in which a hull's corners are looked for
SAMPLES = 160  # of what was recorded, kept for the density
ASKED = 240  # samples of an episode that are looked at
STEPS = 120  # of the search for the nearest point of a hull
TOUCH = 0.02  # of a range: as near to the hull is inside
NEAR = 0.99  # of the recorded samples are as near to a kept one
WARNED = 0.05  # of an episode outside: worth a warning
LEAST = 1e-12  # of a range, to divide by
DIGITS = 6  # of the numbers that are kept


@dataclass(frozen=True, slots=True, eq=False)
class Coverage:
    """The region of one joint's recorded motion: ranges `(3,)`, corners of the hull `(corners, 3)`,
    samples `(samples, 3)`, and the distance `near` that counts as near.

    Corners and samples are in units of the ranges.
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
        off = beyond | (_from_hull(self.corners, x) > TOUCH)
        return {
            "box": float(beyond.mean()),
            "hull": float(off.mean()),
            "density": float((_from_samples(self.samples, x) > self.near).mean()),
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
        corners = x[np.unique((x @ _directions().T).argmax(axis=0))]
        chosen = x[:: -(-len(x) // SAMPLES)]
        # as far from chosen ones as samples can be
        between = x[len(x) // (2 * SAMPLES) :: -(-len(x) // SAMPLES)]
        near = float(np.quantile(_from_samples(chosen, between), NEAR)) + TOUCH
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


def _directions() -> Array:
    """Directions spread evenly over a sphere, `(DIRECTIONS, 3)`: a spiral of golden turns."""
    i = np.arange(DIRECTIONS) + 0.5
    z, turn = 1.0 - 2.0 * i / DIRECTIONS, np.pi * (1.0 + np.sqrt(5.0)) * i
    flat = np.sqrt(1.0 - z**2)
    return np.stack([flat * np.cos(turn), flat * np.sin(turn), z], axis=1)


def _from_hull(corners: Array, x: Array) -> Array:
    """Distance of points `(n, 3)` from the hull of corners, from above, `(n,)`."""
    at = np.repeat(corners.mean(axis=0)[None, :], len(x), axis=0)
    for _ in range(STEPS):
        towards = corners[((x - at) @ corners.T).argmax(axis=1)] - at
        length = np.maximum(np.einsum("ij,ij->i", towards, towards), LEAST)
        part = np.clip(np.einsum("ij,ij->i", x - at, towards) / length, 0.0, 1.0)
        at = at + part[:, None] * towards
    return np.asarray(np.linalg.norm(x - at, axis=1))


def _from_samples(samples: Array, x: Array) -> Array:
    """Distance of points `(n, 3)` from the nearest sample, `(n,)`."""
    return np.asarray(np.sqrt(((x[:, None, :] - samples[None, :, :]) ** 2).sum(axis=2).min(axis=1)))
