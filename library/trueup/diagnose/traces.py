"""Traces: recordings as they are drawn: what was measured, what was commanded, and what models
predict of it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from trueup.canonical import Json
from trueup.episode.episode import Episode
from trueup.episode.layout import Channel
from trueup.model.plant import Plant
from trueup.model.predictor import Predictor, predict_observations
from trueup.model.state import known_from
from trueup.model.windows import cut, starts_every

Array = NDArray[np.float64]
Told = Sequence[tuple[int, Channel]]  # observations with their columns
POINTS = 24_000  # of all drawn lines together: half a megabyte of text would be too slow to load
LEAST, MOST = 300, 2000  # of one line
DIGITS = 5
BEYOND = 1e9  # standard deviations: a rollout that ran away is drawn no further


def traces(
    plant: Plant, episodes: Sequence[Episode], models: Mapping[str, Predictor], columns: Told
) -> list[Json]:
    """Some channels of some episodes, and each model's prediction: rollouts on the issued commands
    alone that start at each multiple of the plant's horizon.
    """
    lines = len(episodes) * ((1 + len(models)) * len(columns) + 1)
    most = int(np.clip(POINTS / max(lines, 1), LEAST, MOST))
    return [
        _trace(
            plant, e, {name: predicted(model, e) for name, model in models.items()}, columns, most
        )
        for e in episodes
    ]


def predicted(model: Predictor, episode: Episode) -> Array:
    """A model's prediction of each sample, `(samples, observations)`; nan where it ran away."""
    windows = cut(model.plant, episode, starts_every(episode.t_s, model.plant.horizon_s))
    with np.errstate(over="ignore", invalid="ignore"):
        values = np.asarray(predict_observations(model, windows)[windows.inside])
        spread = np.nanstd(episode.observations, axis=0)
        return np.where(np.abs(values) < BEYOND * np.maximum(spread, 1e-300), values, np.nan)


def _trace(
    plant: Plant, episode: Episode, paths: Mapping[str, Array], columns: Told, most: int
) -> Json:
    begin = known_from(plant, episode)
    every = max(1, math.ceil((len(episode.t_s) - begin) / most))
    drawn = np.arange(begin, len(episode.t_s), every)
    channels: list[Json] = []
    for at, channel in columns:
        measured = episode.observations[:, at]
        channels.append(
            {
                **named(plant, channel),
                "envelope": list(plant.envelope[channel.name])
                if channel.name in plant.envelope
                else None,
                "measured": numbers(measured[drawn]),
                **{name: numbers(path[drawn, at]) for name, path in paths.items()},
                "rms": {
                    name: number(rms(path[begin:, at] - measured[begin:]))
                    for name, path in paths.items()
                },
            }
        )
    joints = {plant.joint_of(c) for _, c in columns}
    commands: list[Json] = [
        _command(plant, c, episode.commands[drawn, i], episode.applied_commands[drawn, i])
        for i, c in enumerate(plant.layout.commands)
        if plant.joint_of(c) in joints
    ]
    return {
        "sha256": episode.digest,
        "samples": len(episode.t_s),
        "every": every,
        "t_s": [round(float(t), 5) for t in episode.t_s[drawn]],
        "channels": channels,
        "commands": commands,
        "applied": "as recorded" if episode.applied is not None else "by the declared limits",
    }


def _command(plant: Plant, channel: Channel, issued: Array, applied: Array) -> Json:
    """A command as it was issued and, where that is anything else, as it was applied."""
    pair = {"issued": numbers(issued), "applied": numbers(applied)}
    same = pair["issued"] == pair["applied"]
    return {**named(plant, channel), **pair, **({"applied": None} if same else {})}


def named(plant: Plant, channel: Channel) -> dict[str, Json]:
    """A channel's name, unit and joint."""
    return {
        "name": channel.name,
        "unit": channel.unit,
        "joint": plant.joint_name(plant.joint_of(channel)),
    }


def rms(missed: Array) -> float:
    """Root mean square of what is known; nan where nothing is."""
    known = missed[np.isfinite(missed)]
    return float(np.sqrt(np.mean(known**2))) if len(known) else math.nan


def number(x: float) -> float | None:
    """A number as it is drawn: no more digits than a screen shows, null for none."""
    return float(f"{x:.{DIGITS}g}") if math.isfinite(x) else None


def numbers(values: Array) -> list[Json]:
    """Several numbers as JSON, rounded, None where they are not finite."""
    return [number(float(x)) for x in values]
