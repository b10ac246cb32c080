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
from trueup.model.windows import cut, starts_every

Array = NDArray[np.float64]
FIRST, EVERY = "first", "every"


@dataclass(frozen=True, slots=True)
class Scoring:
    """What is measured: rollouts over `horizon_s` [s], from the `first` window of each episode or from `every` one."""

    horizon_s: float
    windows: str = FIRST

    def document(self) -> dict[str, Json]:
        """The same as JSON."""
        return {"horizon_s": self.horizon_s, "windows": self.windows}


@dataclass(frozen=True, slots=True)
class Score:
    """Errors of one predictor: per episode the mean over a rollout, and the error of its first step, `(episodes,)` each."""

    rollout: Array
    one_step: Array


def score(predictor: Predictor, episodes: Sequence[Episode], scoring: Scoring) -> Score:
    """Dimensionless errors: at each predicted sample the norm over channels of (predicted - observed) / declared scale."""
    pairs = [_score_one(predictor, e, scoring) for e in episodes]
    return Score(np.array([p[0] for p in pairs]), np.array([p[1] for p in pairs]))


def _score_one(predictor: Predictor, episode: Episode, scoring: Scoring) -> tuple[float, float]:
    errors, inside = rollout_errors(predictor, episode, scoring)
    return float(errors[:, 1:][inside[:, 1:]].mean()), float(errors[:, 1][inside[:, 1]].mean())


def rollout_errors(predictor: Predictor, episode: Episode, scoring: Scoring) -> tuple[Array, NDArray[np.bool_]]:
    """The error at each sample of each window, `(windows, samples)`, and which of them count."""
    plant = predictor.plant
    windows = cut(plant, episode, *_starts(plant, episode, scoring))
    missed = (predict_observations(predictor, windows) - episode.observations[windows.rows]) / plant.scales
    known = np.isfinite(episode.observations).any(axis=0)
    with np.errstate(over="ignore", invalid="ignore"):  # a predictor that runs away scores inf or nan, and no gate passes that
        return np.linalg.norm(missed[:, :, known], axis=2), windows.inside


def _starts(plant: Plant, episode: Episode, scoring: Scoring) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Each window's first sample and length: from where the state is known, its start and the samples up to the horizon.

    Raises NotAnEpisode where there is none.
    """
    starts = starts_every(episode.t_s, scoring.horizon_s, float(episode.t_s[known_from(plant, episode)]))
    ends = np.searchsorted(episode.t_s, episode.t_s[starts] + scoring.horizon_s * (1 + 1e-9), side="right")
    predicted = ends - starts > 1
    if not predicted.any():
        raise NotAnEpisode(
            f"episode {episode.digest[:12]} has no two samples within {scoring.horizon_s:g} s to score",
            rule="samples",
            digest=episode.digest,
        )
    starts, lengths = starts[predicted], (ends - starts)[predicted]
    return (starts[:1], lengths[:1]) if scoring.windows == FIRST else (starts, lengths)


def rollout_rms(predictor: Predictor, episode: Episode, horizon_s: float) -> Array:
    """Root mean square error of each observation over every window, in its own unit, `(observations,)`."""
    plant: Plant = predictor.plant
    windows = cut(plant, episode, *_starts(plant, episode, Scoring(horizon_s, EVERY)))
    missed = predict_observations(predictor, windows) - episode.observations[windows.rows]
    with np.errstate(over="ignore", invalid="ignore"):
        return np.asarray(np.sqrt(np.mean(missed[:, 1:][windows.inside[:, 1:]] ** 2, axis=0)))
