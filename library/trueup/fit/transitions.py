"""Transitions: what the state did over a short span, ready for regression.

With velocity observed a span is one sample. Otherwise the velocity is itself an estimate,
neighbouring ones share their noise, and a span as long as the estimate's own is used: the change
over a span integrates the dynamics instead of differentiating them. Source of the integral form: E.
Eykhoff, System Identification (1974), chapter 7, method of modulating functions with a rectangular
window.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from trueup.episode.episode import Episode
from trueup.episode.role import Role
from trueup.errors import NotIdentifiable
from trueup.model.plant import Plant
from trueup.model.state import smoothed_states
from trueup.model.windows import intervals

Array = NDArray[np.float64]
SPAN_S = 0.05  # a span for estimated velocities: several estimates long, short against the motion


@dataclass(frozen=True, slots=True)
class Transitions:
    """Single steps of several episodes, and the spans over which they are summed.

    `states` `(n, states)`, `issued` `(n, commands)`, `after` `(n, states)`, `h_s` `(n,)` [s];
    `span` samples make one regression row; `bounds` are the (first, last) steps of each episode.
    """

    states: Array
    issued: Array
    after: Array
    h_s: Array
    span: int
    bounds: tuple[tuple[int, int], ...]

    def sums(self, values: Array) -> Array:
        """Sum over each span of `(n, …)` per-step values, spans never reaching over two episodes,
        `(rows, …)`."""
        if self.span == 1:
            return values
        parts = []
        for first, last in self.bounds:
            total = np.cumsum(
                np.concatenate([np.zeros_like(values[:1]), values[first:last]]), axis=0
            )
            parts.append(total[self.span :] - total[: -self.span])
        return np.concatenate(parts)


def transitions(
    plant: Plant, episodes: Sequence[Episode], role: Role = Role.ADAPTATION
) -> Transitions:
    """The transitions of episodes of one role. Raises RoleRefused, NotIdentifiable."""
    if not episodes:
        raise NotIdentifiable(f"there is no {role} episode to fit")
    parts = [_of_one(plant, e.require(role)) for e in episodes]
    estimated = len(plant.layout.observations) < 2 * plant.dynamics.joints or any(
        e.missing for e in episodes
    )
    span = max(1, round(SPAN_S / np.median([e.period_s for e in episodes]))) if estimated else 1
    kept = [p for p in parts if len(p[0]) > span]
    if not kept:
        raise NotIdentifiable(f"every episode is shorter than {span} samples")
    ends = np.cumsum([0] + [len(p[0]) for p in kept])
    states, issued, after, h_s = (np.concatenate(column) for column in zip(*kept, strict=True))
    return Transitions(
        states, issued, after, h_s, span, tuple((int(a), int(b)) for a, b in pairwise(ends))
    )


def _of_one(plant: Plant, episode: Episode) -> tuple[Array, Array, Array, Array]:
    states = smoothed_states(plant, episode)
    h_s, steps = intervals(episode.t_s, plant.timestep_s)
    return states[:-1], episode.commands[:-1], states[1:], (h_s * np.maximum(steps, 1))[:-1]
