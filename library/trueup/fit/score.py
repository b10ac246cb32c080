"""Score: how far a predictor's rollouts are from held-out episodes, in declared units."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueup.canonical import Json
from trueup.episode.episode import Episode
from trueup.errors import NotAnEpisode
from trueup.model.plant import Plant
from trueup.model.predictor import Predictor, predict_observations
from trueup.model.state import known_from
from trueup.model.windows import Windows, cut, starts_every

Array = NDArray[np.float64]
FIRST, EVERY = "first", "every"


@dataclass(frozen=True, slots=True)
class Scoring:
    """What is measured: rollouts over `horizon_s` [s], from the `first` window of each episode or
    from `every` one."""

    horizon_s: float
    windows: str = FIRST

    def document(self) -> dict[str, Json]:
        """The score as JSON."""
        return {"horizon_s": self.horizon_s, "windows": self.windows}


@dataclass(frozen=True, slots=True)
class Windowed:
    """Errors of one episode by window: the mean over a rollout and the error of its first step, and
    how many samples were predicted, `(windows,)` each.
    """

    rollout: Array
    one_step: Array
    samples: Array


@dataclass(frozen=True, slots=True)
class Score:
    """Errors of one predictor: per episode the mean over a rollout, and the error of its first
    step, `(episodes,)` each.

    `windows` are the same by window, where they are known.
    """

    rollout: Array
    one_step: Array
    windows: tuple[Windowed, ...] = ()


@dataclass(frozen=True, slots=True)
class Missed:
    """What was predicted minus what was observed, `(windows, samples, channels)` in the channels'
    own units; where `inside` the window."""

    by: Array
    inside: NDArray[np.bool_]

    def norms(self, scales: Array) -> Array:
        """Dimensionless errors with these reporting scales `(channels,)`, `(windows, samples)`."""
        # a predictor that runs away scores inf or nan, and no gate passes that
        with np.errstate(over="ignore", invalid="ignore"):
            return np.asarray(np.linalg.norm(self.by / scales, axis=2))


def score(predictor: Predictor, episodes: Sequence[Episode], scoring: Scoring) -> Score:
    """Dimensionless errors: at each predicted sample the norm over channels of (predicted -
    observed) / declared scale."""
    return score_of([missed(predictor, e, scoring) for e in episodes], predictor.plant.scales)


def score_of(each: Sequence[Missed], scales: Array) -> Score:
    """The score of what was missed in each episode, with these reporting scales `(channels,)`."""
    pairs = [_score_one(one, scales) for one in each]
    return Score(
        np.array([p[0] for p in pairs]), np.array([p[1] for p in pairs]), tuple(p[2] for p in pairs)
    )


def _score_one(one: Missed, scales: Array) -> tuple[float, float, Windowed]:
    errors, inside = one.norms(scales), one.inside
    counts = inside[:, 1:].sum(axis=1)
    with np.errstate(over="ignore", invalid="ignore"):
        means = np.where(inside[:, 1:], errors[:, 1:], 0.0).sum(axis=1) / counts
    windowed = Windowed(means, errors[:, 1], counts.astype(np.float64))
    return (
        float(errors[:, 1:][inside[:, 1:]].mean()),
        float(errors[:, 1][inside[:, 1]].mean()),
        windowed,
    )


def rollout_errors(
    predictor: Predictor, episode: Episode, scoring: Scoring
) -> tuple[Array, NDArray[np.bool_]]:
    """The error at each sample of each window, `(windows, samples)`, and which of them count."""
    errors = missed(predictor, episode, scoring)
    return errors.norms(predictor.plant.scales), errors.inside


def missed(predictor: Predictor, episode: Episode, scoring: Scoring) -> Missed:
    """What a predictor missed in an episode, of the channels that are observed in it; others count
    as 0."""
    windows = scored_windows(predictor.plant, episode, scoring)
    return missed_in(predictor, windows)


def missed_in(predictor: Predictor, windows: Windows) -> Missed:
    """What a predictor missed in some windows of an episode."""
    observed = windows.episode.observations
    by = predict_observations(predictor, windows) - observed[windows.rows]
    by[:, :, ~np.isfinite(observed).any(axis=0)] = 0.0
    return Missed(by, windows.inside)


def scored_windows(plant: Plant, episode: Episode, scoring: Scoring) -> Windows:
    """The windows in which a predictor is scored. Raises NotAnEpisode where there is none."""
    return cut(plant, episode, *_starts(plant, episode, scoring))


def _starts(
    plant: Plant, episode: Episode, scoring: Scoring
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Each window's first sample and length: from where the state is known, its start and the
    samples up to the horizon.

    Raises NotAnEpisode where there is none.
    """
    starts = starts_every(
        episode.t_s, scoring.horizon_s, float(episode.t_s[known_from(plant, episode)])
    )
    ends = np.searchsorted(
        episode.t_s, episode.t_s[starts] + scoring.horizon_s * (1 + 1e-9), side="right"
    )
    predicted = ends - starts > 1
    if not predicted.any():
        raise NotAnEpisode(
            (
                f"episode {episode.digest[:12]} has no two samples within {scoring.horizon_s:g} "
                "s to score"
            ),
            rule="samples",
            digest=episode.digest,
        )
    starts, lengths = starts[predicted], (ends - starts)[predicted]
    return (starts[:1], lengths[:1]) if scoring.windows == FIRST else (starts, lengths)


@dataclass(frozen=True, slots=True)
class LeftOut:
    """A stretch of an episode that no window scores [s], and why."""

    from_s: float
    to_s: float
    why: str


def left_out(plant: Plant, episode: Episode, scoring: Scoring) -> list[LeftOut]:
    """What of an episode is not scored: what precedes the first known state, windows of one sample,
    and where the first window alone counts, all after it. Raises NotAnEpisode where nothing is
    scored."""
    t_s, windows = episode.t_s, scored_windows(plant, episode, scoring)
    known_s = float(t_s[known_from(plant, episode)])
    stretches = []
    if known_s > 0.0:
        stretches.append(LeftOut(0.0, known_s, "the velocity is not known yet"))
    if scoring.windows == FIRST:
        end = float(t_s[windows.first[0] + windows.lengths[0] - 1])
        if end < t_s[-1]:
            why = "the gate scores the first window alone"
            stretches.append(LeftOut(end, float(t_s[-1]), why))
        return stretches
    every = starts_every(t_s, scoring.horizon_s, known_s)
    # a window ends on the sample at which the next one starts
    scored = np.concatenate([windows.first, windows.first + windows.lengths - 1])
    alone = np.setdiff1d(every, scored)
    stretches += [
        LeftOut(float(t_s[i]), float(t_s[i]), "a window of one sample has nothing to predict")
        for i in alone
    ]
    return stretches


def rms_of(one: Missed, episode: Episode) -> Array:
    """Root mean square of what was missed of each observation of an episode, in its own unit,
    `(observations,)`; nan where it was never observed."""
    with np.errstate(over="ignore", invalid="ignore"):
        rms = np.sqrt(np.mean(one.by[:, 1:][one.inside[:, 1:]] ** 2, axis=0))
    return np.where(np.isfinite(episode.observations).any(axis=0), rms, np.nan)


def rollout_rms(predictor: Predictor, episode: Episode, horizon_s: float) -> Array:
    """Root mean square error of each observation over every window, in its own unit,
    `(observations,)`; nan where it was never observed."""
    return rms_of(missed(predictor, episode, Scoring(horizon_s, EVERY)), episode)
