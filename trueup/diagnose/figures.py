"""Figures: the numbers behind a diagnosis' pictures, as JSON, schema `trueup.figures/1`.

episodes   held-out recordings: what was measured, and what the nominal and the corrected model predict of it on the issued commands alone,
           rollouts starting anew at each multiple of the horizon
maps       for each channel, what the nominal model, the refitted one and the corrected one miss over short strides: the mean signed
           residual over speed and command, speed and time, command and time, over all episodes

Of a robot, the channels of the joints that the report names.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from trueup.canonical import Json
from trueup.diagnose.locate import STRIDE_S, Strides, strides_of
from trueup.episode.episode import Episode
from trueup.episode.layout import Channel, Field
from trueup.model.hypothesis import Hypothesis
from trueup.model.plant import Plant
from trueup.model.predictor import Nominal, Predictor
from trueup.model.state import known_from
from trueup.model.windows import cut, starts_every

if TYPE_CHECKING:
    from trueup.diagnose.diagnosis import Diagnosis

Array = NDArray[np.float64]
SCHEMA = "trueup.figures/1"
FIGURES_FILE = "figures.json"
POINTS = 24_000  # of all drawn lines together: half a megabyte of text would be too slow to load
LEAST, MOST = 300, 2000  # of one line
EPISODES = 4  # held-out recordings that are drawn, those that move furthest
CELLS = 16  # of a map at most, along speed and command; half as many again along time
FILLED = 6.0  # strides to a cell, as an average: fewer show noise
ENDS = 0.005  # of the samples, at either end of an axis, that fall into its first and last cell
SCALE = 0.98  # of the cells: the part that a colour scale reaches
DIGITS = 5
PAIRS = (("speed", "command"), ("time", "speed"), ("time", "command"))
BEYOND = 1e9  # standard deviations: a rollout that ran away is drawn no further


def figures(found: Diagnosis, episodes: Sequence[Episode]) -> dict[str, Json]:
    """The numbers behind the pictures of a diagnosis of these episodes."""
    plant, told = found.plant, _told(found)
    moved = sorted(found.validation, key=lambda e: -float(np.nanmax(np.nanstd(e.observations, axis=0) / np.array(plant.scales))))[:EPISODES]
    models = {"nominal": Nominal(plant), "corrected": found.predictor}
    lines = sum((1 + len(models)) * len(told) + 1 for _ in moved)
    most = int(np.clip(POINTS / max(lines, 1), LEAST, MOST))
    base = found.search.found[Hypothesis()].fit
    layers = {
        layer: strides_of(plant, found.search, fit, episodes)
        for layer, fit in (("nominal", found.nominal), ("refitted", base), ("corrected", found.choice.winner.fit))
    }
    return {
        "schema": SCHEMA,
        "plant": plant.name,
        "horizon_s": plant.horizon_s,
        "stride_s": STRIDE_S,
        "episodes": [_traces(plant, e, models, told, most) for e in moved],
        "maps": [_map(plant, channel, int(plant.state_columns[at]), layers, episodes) for at, channel in told],
        "experiment": _experiment(found),
    }


def _experiment(found: Diagnosis) -> Json:
    """The command of the next experiment, if there is one."""
    plant, next_ = found.plant, found.experiment
    if next_ is None or next_.command is None:
        return None
    drawn = slice(None, None, max(1, math.ceil(len(next_.t_s) / MOST)))
    commands: list[Json] = [
        {**_named(plant, c), "issued": _numbers(next_.command[drawn, plant.joint_of(c)])} for c in plant.layout.commands
    ]
    return {"t_s": _numbers(next_.t_s[drawn]), "commands": commands}


def _told(found: Diagnosis) -> list[tuple[int, Channel]]:
    """The observations that are drawn, with their columns."""
    plant = found.plant
    every = list(enumerate(plant.layout.observations))
    if len(plant.joints) == 1:
        return every
    where = found.document["where"]
    joints = {e.get("joint") for e in found.document["effects"]} or {where.get("regions_of")}  # type: ignore[union-attr]
    return [(at, c) for at, c in every if plant.joint_name(plant.joint_of(c)) in joints] or every


def _traces(plant: Plant, episode: Episode, models: Mapping[str, Predictor], told: Sequence[tuple[int, Channel]], most: int) -> Json:
    begin = known_from(plant, episode)
    every = max(1, math.ceil((len(episode.t_s) - begin) / most))
    drawn = np.arange(begin, len(episode.t_s), every)
    starts = starts_every(episode.t_s, plant.horizon_s)
    predicted = {name: _predicted(model, episode, starts) for name, model in models.items()}
    channels: list[Json] = []
    for at, channel in told:
        measured = episode.observations[:, at]
        missed = {name: p[begin:, at] - measured[begin:] for name, p in predicted.items()}
        channels.append(
            {
                **_named(plant, channel),
                "measured": _numbers(measured[drawn]),
                **{name: _numbers(p[drawn, at]) for name, p in predicted.items()},
                "rms": {name: _number(float(np.sqrt(np.nanmean(m**2)))) for name, m in missed.items()},
            }
        )
    joints = {plant.joint_of(c) for _, c in told}
    commands: list[Json] = [
        {**_named(plant, c), "issued": _numbers(episode.commands[drawn, i])}
        for i, c in enumerate(plant.layout.commands)
        if plant.joint_of(c) in joints
    ]
    return {
        "sha256": episode.digest,
        "samples": len(episode.t_s),
        "every": every,
        "t_s": [round(float(t), 5) for t in episode.t_s[drawn]],
        "starts_s": [round(float(t), 5) for t in episode.t_s[starts]],
        "channels": channels,
        "commands": commands,
    }


def _predicted(model: Predictor, episode: Episode, starts: NDArray[np.int64]) -> Array:
    windows = cut(model.plant, episode, starts)
    with np.errstate(over="ignore", invalid="ignore"):
        found = np.asarray(model.plant.observe(model.rollout(windows))[windows.inside])
        spread = np.nanstd(episode.observations, axis=0)
        return np.where(np.abs(found) < BEYOND * np.maximum(spread, 1e-300), found, np.nan)


def _named(plant: Plant, channel: Channel) -> dict[str, Json]:
    return {"name": channel.name, "unit": channel.unit, "joint": plant.joint_name(plant.joint_of(channel))}


def _map(plant: Plant, channel: Channel, column: int, layers: Mapping[str, Strides], episodes: Sequence[Episode]) -> Json:
    """One channel's residuals over each pair of speed, command and time."""
    joint = plant.joint_of(channel)
    some = layers["nominal"]
    longest = max(float(e.t_s[-1]) for e in episodes)
    lasts = np.array([float(e.t_s[-1]) for e in episodes])
    places = {"speed": some.v[:, joint], "command": some.u[:, joint], "time": some.t * lasts[some.episode]}
    units = {"speed": _speed_unit(plant, joint), "command": _command_unit(plant, joint), "time": "s"}
    cells = int(np.clip(math.sqrt(len(some.t) / FILLED), 5, CELLS))
    edges = {
        "speed": _edges(places["speed"], cells),
        "command": _edges(places["command"], cells),
        "time": np.linspace(0.0, longest, round(1.5 * cells) + 1),
    }
    inside = {axis: np.clip(np.digitize(places[axis], edges[axis]) - 1, 0, len(edges[axis]) - 2) for axis in edges}
    drawn: dict[str, Json] = {}
    largest: list[Array] = []
    for layer, strides in layers.items():
        means = {f"{a}-{b}": _means(strides.missed[:, column], (inside[a], inside[b]), (edges[a], edges[b])) for a, b in PAIRS}
        largest += [np.abs(m[np.isfinite(m)]) for m in means.values()]
        drawn[layer] = {pair: [_numbers(row) for row in m] for pair, m in means.items()}
    reached = np.concatenate(largest)
    return {
        **_named(plant, channel),
        "rms": {layer: _number(float(np.sqrt(np.nanmean(s.missed[:, column] ** 2)))) for layer, s in layers.items()},
        "scale": _number(float(np.quantile(reached, SCALE))) if len(reached) else 0.0,
        "axes": {axis: {"unit": units[axis], "edges": _numbers(edges[axis])} for axis in edges},
        "layers": drawn,
    }


def _means(missed: Array, inside: tuple[NDArray[np.int64], NDArray[np.int64]], edges: tuple[Array, Array]) -> Array:
    """Mean of what was missed in each cell, `(second, first)`, nan where nothing was recorded."""
    columns, rows = len(edges[0]) - 1, len(edges[1]) - 1
    fine = np.isfinite(missed)
    cell = (inside[1] * columns + inside[0])[fine]
    count = np.bincount(cell, minlength=rows * columns)
    total = np.bincount(cell, missed[fine], minlength=rows * columns)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan).reshape(rows, columns)


def _edges(values: Array, cells: int) -> Array:
    low, high = (float(np.nanquantile(values, q)) for q in (ENDS, 1.0 - ENDS))
    if high <= low:
        low, high = low - 0.5, high + 0.5
    return np.linspace(low, high, cells + 1)


def _speed_unit(plant: Plant, joint: int) -> str:
    of = {c.field: c.unit for c in plant.layout.observations if plant.joint_of(c) == joint}
    return of.get(Field.VELOCITY) or f"{of.get(Field.POSITION, '1')}/s"


def _command_unit(plant: Plant, joint: int) -> str:
    at = int(plant.command_columns[joint])
    return plant.layout.commands[at].unit if at >= 0 else "1"


def _number(x: float) -> float | None:
    return float(f"{x:.{DIGITS}g}") if math.isfinite(x) else None


def _numbers(values: Array) -> list[Json]:
    return [_number(float(x)) for x in values]
