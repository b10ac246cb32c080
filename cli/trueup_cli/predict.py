"""`trueup predict`: roll a model out over an episode, window by window."""

from __future__ import annotations

import csv
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from cyclopts import Parameter

from trueup.artifact.model import load
from trueup.episode.episode import Episode
from trueup.episode.mcap import read_episode_stream
from trueup.fit.score import EVERY, FIRST, Scoring, left_out, missed, rms_of, score, score_of
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
    measured: Annotated[
        bool,
        Parameter(negative=(), help="Write what was measured, too, as columns measured_NAME"),
    ] = False,
    as_json_: Json = False,
) -> None:
    """Predict an episode and write one CSV row for each of its samples.

    Prints the root mean square error of each channel, and the error by which a gate with this
    horizon would judge the model. Both leave out the rows at which rollouts start.

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
    plant, scoring = predictor.plant, Scoring(horizon, EVERY)
    errors = missed(predictor, recorded, scoring)
    every = score_of([errors], plant.scales)
    first = score(predictor, [recorded], Scoring(horizon, FIRST))
    summary = {
        "file": str(out),
        "samples": len(predicted),
        "rms": {
            c.name: float(x)
            for c, x in zip(plant.layout.observations, rms_of(errors, recorded), strict=True)
        },
        "gate": {
            "horizon_s": horizon,
            "every": float(every.rollout[0]),
            "first": float(first.rollout[0]),
            "windows": len(every.windows[0].rollout),
        },
        "left_out": [asdict(s) for s in left_out(plant, recorded, scoring)],
    }
    write_csv(out, predictor, recorded, predicted, measured=measured)
    if as_json_:
        as_json(summary)
    else:
        _show(summary, {c.name: c.unit for c in plant.layout.observations})


def _show(summary: dict[str, Any], units: dict[str, str]) -> None:
    rms, gate = summary["rms"], summary["gate"]
    errors = ", ".join(f"{name} {x:.3g} {units[name]}".rstrip() for name, x in rms.items())
    say("{}: {} samples; RMS error {}", summary["file"], summary["samples"], errors)
    say(
        "As a gate judges it, over {} s in reporting scales: {} in all {} windows, {} in the first",
        f"{gate['horizon_s']:g}",
        f"{gate['every']:.17g}",
        gate["windows"],
        f"{gate['first']:.17g}",
    )
    for stretch in summary["left_out"]:
        say(
            "Left out: {} to {} s, {}",
            f"{stretch['from_s']:.4g}",
            f"{stretch['to_s']:.4g}",
            stretch["why"],
        )


def write_csv(
    to: Path, predictor: Predictor, episode: Episode, predicted: np.ndarray, *, measured: bool
) -> None:
    """Writes `t,<observation names…>`: t [s] from the first sample, all with full float digits;
    then, where asked for, what was measured."""
    names = [c.name for c in predictor.plant.layout.observations]
    values = [predicted, episode.observations] if measured else [predicted]
    beside = [f"measured_{name}" for name in names] if measured else []
    with to.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["t", *names, *beside])
        writer.writerows(
            [repr(float(t)), *(repr(float(x)) for x in row)]
            for t, row in zip(episode.t_s, np.hstack(values), strict=True)
        )
