"""Trimming: stretches of a machine's recordings in which something outside the model acted, such as
a hand or an obstacle.

A sum of squares is mostly its largest terms, so one push can hide from a search what acts
everywhere else. So compositions are fitted once more by least trimmed squares: each to the windows
that it explains best. A window that all of them still miss by far is put aside. Source: P. J.
Rousseeuw, Journal of the American Statistical Association 79 (1984).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trueup.canonical import Json
from trueup.cores import in_parallel
from trueup.diagnose.candidate import Candidate
from trueup.diagnose.search import Search
from trueup.diagnose.tuning_of_answers import TRIMMING
from trueup.episode.episode import Episode, recording_of
from trueup.fit.rollout_fit import RolloutFit
from trueup.model.series import Series


@dataclass(frozen=True, slots=True)
class Stretch:
    """A part of a recording, between two times [s] since the recording began."""

    recording: str
    from_s: float
    to_s: float

    def document(self) -> dict[str, Json]:
        """The stretch as the report gives it."""
        return {"episode": self.recording, "from_s": self.from_s, "to_s": self.to_s}


def unexplained_stretches(search: Search) -> list[Stretch]:
    """The windows of a machine's joint that no composition of one effect explains, even when it is
    fitted without them, nor of the best of those and another; none where they are more than a few.
    """
    sound = [c for c in search if len(c.hypothesis.effects) <= 1 and np.isfinite(c.total)]
    likely = sorted(sound, key=_typical)[: TRIMMING.compositions]
    trimmed = list(in_parallel(lambda c: _trimmed(search, c), likely))
    if not _unexplained(trimmed).any():
        return []
    pairs = search.extend([min(trimmed, key=_typical)], search.terms, most=TRIMMING.beside)
    trimmed += in_parallel(lambda c: _trimmed(search, c), pairs)
    aside, at = _unexplained(trimmed), trimmed[0]
    fitted, compared = np.split(aside, [len(at.fit.costs)])
    by_episode = at.fit.split(fitted) | at.check.split(compared)
    data = [*search.problem.adaptation, *search.problem.validation]
    return [stretch for s in data for stretch in _stretches(s, by_episode[s.digest])]


def _unexplained(candidates: Sequence[Candidate]) -> NDArray[np.bool_]:
    """Windows that cost every candidate far more than its typical one, `(windows,)`; none where
    they are more than a few. One whose typical window is far worse than that of the best says
    nothing of a single window."""
    best = min(map(_typical, candidates))
    aside = np.logical_and.reduce(
        [
            c.costs > TRIMMING.unexplained * _typical(c)
            for c in candidates
            if _typical(c) <= TRIMMING.as_good * best
        ]
    )
    few = bool(aside.mean() <= 1.0 - TRIMMING.kept)
    return np.asarray(aside if few else np.zeros_like(aside))


def without(episode: Episode, stretches: Sequence[Stretch], fewest: int) -> list[Episode]:
    """What is left of an episode, in parts of so many samples at least."""
    since_s = episode.begins_s + episode.t_s
    kept = np.ones(len(since_s), dtype=bool)
    for s in stretches:
        if s.recording == episode.recording:
            kept &= (since_s < s.from_s) | (since_s >= s.to_s)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], kept.astype(int), [0]])))
    return [
        episode.part(int(first), int(last))
        for first, last in edges.reshape(-1, 2)
        if last - first >= fewest
    ]


def _typical(candidate: Candidate) -> float:
    """The median cost of a window."""
    return float(np.median(candidate.costs))


def _trimmed(search: Search, candidate: Candidate) -> Candidate:
    """The candidate fitted to those windows that it explains best, measured on all."""
    fits, fit = search.problem.fits, candidate.fit
    fixed = fits.resting(fit.values, fit.hypothesis.effects)
    for _ in range(TRIMMING.looks):
        limit = max(
            np.quantile(fit.costs, TRIMMING.kept, method="inverted_cdf"),
            TRIMMING.ordinary * np.median(fit.costs),
        )
        data = _masked(fits.adaptation, fit, float(limit))
        values = fits.taken_on(data, fit, TRIMMING.iterations, fixed).values
        fit = fits.taken_on(fits.adaptation, replace(fit, values=values), 0, fixed)
    return fits.candidate(fit)


def _masked(data: Sequence[Series], fit: RolloutFit, limit: float) -> list[Series]:
    """Episodes without the samples of windows that cost a fit more than a limit."""
    far_off = {key: np.flatnonzero(costs > limit) for key, costs in fit.split(fit.costs).items()}
    return [
        replace(s, usable=s.usable & ~np.isin(s.window_of, far_off[s.digest])[:, None])
        for s in data
    ]


def _stretches(s: Series, flagged: NDArray[np.bool_]) -> list[Stretch]:
    """The flagged windows of an episode, in time."""
    recording = recording_of(s.digest)
    ends = np.append(s.t_s[np.flatnonzero(s.resets >= 0)], s.t_s[-1] + s.period_s)
    return [Stretch(recording, float(ends[w]), float(ends[w + 1])) for w in np.flatnonzero(flagged)]
