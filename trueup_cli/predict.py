"""`trueup predict`: roll a model out over an episode, window by window."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Annotated

import numpy as np
from cyclopts import Parameter

from trueup.episode.episode import Episode
from trueup.episode.mcap import read_episode_stream
from trueup.model.predictor import Nominal, Predictor, predict_observations
from trueup.model.windows import cut, starts_every
from trueup_cli.model_folder import load_predictor


def predict(
    *,
    model: Path,
    episode: Path,
    horizon: float,
    out: Path,
    nominal: Annotated[bool, Parameter(negative=(), help="Predict with the uncorrected nominal model")] = False,
) -> None:
    """Predict an episode and write one CSV row for each of its samples.

    Parameters
    ----------
    model: folder of a fetched model
    episode: MCAP file
    horizon: seconds between the starts of rollouts
    out: CSV file to write
    """
    predictor = load_predictor(model)
    predictor = Nominal(predictor.plant) if nominal else predictor
    with episode.open("rb") as file:
        recorded = read_episode_stream(file, episode.stat().st_size, predictor.plant.layout)
    write_csv(out, predictor, recorded, predict_samples(predictor, recorded, horizon))


def predict_samples(predictor: Predictor, episode: Episode, horizon_s: float) -> np.ndarray:
    """Predicted observations at every sample `(samples, observations)`; rollouts start at each multiple of the horizon [s]."""
    windows = cut(predictor.plant, episode, starts_every(episode.t_s, horizon_s))
    predicted = predict_observations(predictor, windows)
    return np.asarray(predicted[windows.inside])


def write_csv(to: Path, predictor: Predictor, episode: Episode, predicted: np.ndarray) -> None:
    """`t,<observation names…>`, t [s] from the first sample, full float digits."""
    with to.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["t", *(c.name for c in predictor.plant.layout.observations)])
        writer.writerows([repr(float(t)), *(repr(float(x)) for x in row)] for t, row in zip(episode.t_s, predicted, strict=True))
