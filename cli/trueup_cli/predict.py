"""`trueup predict`: roll a model out over an episode, window by window."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Annotated

import numpy as np
from cyclopts import Parameter

from trueup.artifact.model import load
from trueup.episode.episode import Episode
from trueup.episode.mcap import read_episode_stream
from trueup.model.predictor import Nominal, Predictor, predict_episode
from trueup_cli.options import Json
from trueup_cli.show import as_json, progress, say


def predict(
    *,
    model: Path,
    episode: Path,
    horizon: float,
    out: Path,
    nominal: Annotated[
        bool, Parameter(negative=(), help="Predict with the uncorrected nominal model")
    ] = False,
    as_json_: Json = False,
) -> None:
    """Predict an episode and write one CSV row for each of its samples.

    Parameters
    ----------
    model
        folder of a fetched model
    episode
        MCAP file
    horizon
        seconds between the starts of rollouts
    out
        CSV file to write
    """
    predictor = load(model).predictor
    predictor = Nominal(predictor.plant) if nominal else predictor
    with episode.open("rb") as file:
        recorded = read_episode_stream(file, episode.stat().st_size, predictor.plant.layout)
    with progress(f"predict {episode.name}"):
        predicted = predict_episode(predictor, recorded, horizon)
    write_csv(out, predictor, recorded, predicted)
    rms = np.sqrt(np.nanmean((predicted - recorded.observations) ** 2, axis=0))
    channels = predictor.plant.layout.observations
    if as_json_:
        as_json(
            {
                "file": str(out),
                "samples": len(predicted),
                "rms": {c.name: float(x) for c, x in zip(channels, rms, strict=True)},
            }
        )
        return
    errors = ", ".join(
        f"{c.name} {x:.3g} {c.unit}".rstrip() for c, x in zip(channels, rms, strict=True)
    )
    say("{}: {} samples; RMS error {}", out, len(predicted), errors)


def write_csv(to: Path, predictor: Predictor, episode: Episode, predicted: np.ndarray) -> None:
    """Writes `t,<observation names…>`: t [s] from the first sample, all with full float digits."""
    with to.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["t", *(c.name for c in predictor.plant.layout.observations)])
        writer.writerows(
            [repr(float(t)), *(repr(float(x)) for x in row)]
            for t, row in zip(episode.t_s, predicted, strict=True)
        )
