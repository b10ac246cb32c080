"""Mends: what is done to an episode so that a fault is no longer in it. Episodes never change; a
mend returns another one."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from trueup.episode.episode import LEAST_SAMPLES, Episode
from trueup.model.series import integral_of

Array = NDArray[np.float64]


class Mend(ABC):
    """A change to the episodes of a plant, by their digests."""

    episodes: tuple[str, ...]

    @abstractmethod
    def apply(self, episode: Episode) -> list[Episode]:
        """The episodes that one becomes, each with its digest."""

    def applied_to(self, episodes: Sequence[Episode]) -> list[Episode]:
        """All episodes, mended where the mend is for them."""
        return [
            mended
            for e in episodes
            for mended in (self.apply(e) if e.recording in self.episodes else [e])
        ]


@dataclass(frozen=True, slots=True)
class Scaled(Mend):
    """Columns multiplied by a factor: a unit, a scale or a sign.

    `observations` and `commands` are columns of the episode's arrays.
    """

    episodes: tuple[str, ...]
    factor: float
    observations: tuple[int, ...] = ()
    commands: tuple[int, ...] = ()

    def apply(self, episode: Episode) -> list[Episode]:
        observed, issued = episode.observations.copy(), episode.commands.copy()
        observed[:, list(self.observations)] *= self.factor
        issued[:, list(self.commands)] *= self.factor
        applied = episode.applied
        if applied is not None and self.commands:
            applied = applied.copy()
            applied[:, list(self.commands)] *= self.factor
        return [replace(episode, observations=observed, commands=issued, applied=applied)]


@dataclass(frozen=True, slots=True)
class Moved(Mend):
    """A constant taken off an observation."""

    episodes: tuple[str, ...]
    observation: int
    offset: float

    def apply(self, episode: Episode) -> list[Episode]:
        observed = episode.observations.copy()
        observed[:, self.observation] -= self.offset
        return [replace(episode, observations=observed)]


@dataclass(frozen=True, slots=True)
class Permuted(Mend):
    """Columns in another order: `observations` and `commands` say from which column each comes."""

    episodes: tuple[str, ...]
    observations: tuple[int, ...]
    commands: tuple[int, ...]

    def apply(self, episode: Episode) -> list[Episode]:
        applied = episode.applied
        return [
            replace(
                episode,
                observations=episode.observations[:, list(self.observations)],
                commands=episode.commands[:, list(self.commands)],
                applied=None if applied is None else applied[:, list(self.commands)],
                effort=None,  # nobody knows at which joint it was measured
            )
        ]


@dataclass(frozen=True, slots=True)
class Shifted(Mend):
    """Observations that happened `late_s` [s] before their stamps; the commands stay where they
    are.

    Each command is held until the next, so that the command at a sample is the one in force when
    the sample was taken.
    """

    episodes: tuple[str, ...]
    late_s: float

    def apply(self, episode: Episode) -> list[Episode]:
        t = episode.t_s
        taken = t - self.late_s
        kept = np.flatnonzero((taken >= t[0]) & (taken <= t[-1]))
        if len(kept) < LEAST_SAMPLES:
            return [episode]
        at = taken[kept]
        return [
            replace(
                episode,
                t_s=at - at[0],
                commands=mean_commands(episode, at),
                observations=episode.observations[kept],
                applied=None,
                effort=None if episode.effort is None else episode.effort[kept],
                begins_s=episode.begins_s + float(at[0]),
                digest=f"{episode.digest}, shifted by {self.late_s:.6g} s",
            )
        ]


def mean_commands(episode: Episode, at: Array) -> Array:
    """The mean command from each of some instants [s] to the next, `(instants, commands)`; the last
    one goes on."""
    integral = integral_of(episode.commands, episode.t_s)
    sums = np.stack([np.interp(at, episode.t_s, column) for column in integral.T], axis=1)
    means = np.diff(sums, axis=0) / np.diff(at)[:, None]
    return np.concatenate([means, means[-1:]])


@dataclass(frozen=True, slots=True)
class Masked(Mend):
    """Values that count no longer: nan in a column, from one instant to another [s] each."""

    episodes: tuple[str, ...]
    observation: int
    spans: tuple[tuple[str, float, float], ...]

    def apply(self, episode: Episode) -> list[Episode]:
        observed = episode.observations.copy()
        for digest, from_s, to_s in self.spans:
            if digest == episode.recording:
                during = (episode.t_s >= from_s - HAIR_S) & (episode.t_s <= to_s + HAIR_S)
                observed[during, self.observation] = np.nan
        return [replace(episode, observations=observed)]


HAIR_S = 1e-9  # an instant is rounded to less than that


@dataclass(frozen=True, slots=True)
class CutAtGaps(Mend):
    """An episode in pieces, between which nothing is known; pieces shorter than `least_s` [s] are
    left out, unless all are: then the longest is kept."""

    episodes: tuple[str, ...]
    least_s: float

    def apply(self, episode: Episode) -> list[Episode]:
        edges = [0, *gaps(episode).tolist(), len(episode.t_s)]
        spans = [(first, last) for first, last in pairwise(edges) if last - first >= LEAST_PIECE]
        lengths = [float(episode.t_s[last - 1] - episode.t_s[first]) for first, last in spans]
        least = min(self.least_s, max(lengths, default=0.0))
        return [
            episode.part(first, last)
            for (first, last), length in zip(spans, lengths, strict=True)
            if length >= least
        ]


LEAST_PIECE = 20  # samples: less shows no motion
# of the intervals are no longer than a usual one; and a gap is so many times as long
USUAL, LONGER = 0.95, 3.0


def gaps(episode: Episode) -> NDArray[np.int64]:
    """Samples before which a gap is, `(gaps,)`: one that is also long beside the usual intervals of
    a log whose stamps are irregular."""
    spans = np.diff(episode.t_s)
    at = episode.gaps
    return at[spans[at - 1] > LONGER * float(np.quantile(spans, USUAL))]


def without_masked(episode: Episode) -> Episode:
    """The episode without the samples of which a position or velocity was masked. A channel that is
    not observed at all stays."""
    seen = np.isfinite(episode.observations)
    kept = np.flatnonzero((seen | ~seen.any(axis=0)).all(axis=1))
    if len(kept) in (len(seen), 0, 1):
        return episode
    at = episode.t_s[kept]
    applied = episode.applied
    return replace(
        episode,
        t_s=at - at[0],
        commands=mean_commands(episode, at),
        observations=episode.observations[kept],
        applied=None if applied is None else applied[kept],
        effort=None if episode.effort is None else episode.effort[kept],
        begins_s=episode.begins_s + float(at[0]),
        digest=f"{episode.digest}, {len(seen) - len(kept)} samples left out",
    )
