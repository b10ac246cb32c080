"""Figures: the numbers behind a diagnosis' pictures, as JSON, schema `trueup.figures/1`.

episodes   held-out recordings: what was measured, and what the nominal and the corrected model
           predict of it
maps       for each channel, what the nominal model, the refitted one and the corrected one miss
           over short strides: the mean signed residual over speed and command, time and speed, time
           and command, over all episodes
experiment the command of the next experiment

Of a robot, the channels of the joints that the report names.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from trueup.canonical import Json
from trueup.diagnose.locate import strides_of
from trueup.diagnose.maps import Places, maps
from trueup.diagnose.traces import MOST, Told, named, number, numbers, rms, traces
from trueup.diagnose.tuning_of_answers import EVIDENCE
from trueup.episode.episode import Episode
from trueup.model.hypothesis import Hypothesis
from trueup.model.predictor import Nominal

if TYPE_CHECKING:
    from trueup.diagnose.diagnosis import Diagnosis

SCHEMA = "trueup.figures/1"
FIGURES_FILE = "figures.json"
EPISODES = 4  # held-out recordings that are drawn, those that move furthest


def figures(diagnosis: Diagnosis) -> dict[str, Json]:
    """The numbers behind the pictures of a diagnosis."""
    plant, columns, episodes = diagnosis.plant, _told(diagnosis), diagnosis.recordings.every
    models = {"nominal": Nominal(plant), "corrected": diagnosis.predictor}
    return {
        "schema": SCHEMA,
        "plant": plant.name,
        "horizon_s": plant.horizon_s,
        "stride_s": EVIDENCE.stride_s,
        "episodes": traces(plant, furthest(diagnosis.validation, plant.scales), models, columns),
        "maps": _maps(diagnosis, episodes, columns),
        "experiment": _experiment(diagnosis),
    }


def furthest(episodes: Sequence[Episode], scales: NDArray[np.float64]) -> list[Episode]:
    """The episodes that move furthest, in declared scales."""
    return sorted(
        episodes, key=lambda e: -float(np.nanmax(np.nanstd(e.observations, axis=0) / scales))
    )[:EPISODES]


def _told(diagnosis: Diagnosis) -> Told:
    """The observations that are drawn, with their columns."""
    plant = diagnosis.plant
    every = list(enumerate(plant.layout.observations))
    if len(plant.joints) == 1:
        return every
    where = diagnosis.document["where"]
    joints = {e.get("joint") for e in diagnosis.document["effects"]} or {where.get("regions_of")}  # type: ignore[union-attr]
    return [(at, c) for at, c in every if plant.joint_name(plant.joint_of(c)) in joints] or every


def _maps(diagnosis: Diagnosis, episodes: Sequence[Episode], columns: Told) -> list[Json]:
    """Each channel's residual over strides, by the nominal model, the refitted one and the
    corrected one."""
    plant, fits = (
        diagnosis.plant,
        {"nominal": diagnosis.nominal, "refitted": diagnosis.search.candidates[Hypothesis()].fit},
    )
    fits["corrected"] = diagnosis.choice.winner.fit
    layers = {
        layer: strides_of(plant, diagnosis.search, fit, episodes) for layer, fit in fits.items()
    }
    some, lasts = layers["nominal"], np.array([float(e.t_s[-1]) for e in episodes])
    drawn: list[Json] = []
    for at, channel in columns:
        joint, column = plant.joint_of(channel), int(plant.state_columns[at])
        missed = {layer: strides.missed[:, column] for layer, strides in layers.items()}
        places = Places(
            plant, joint, some.v[:, joint], some.u[:, joint], some.t * lasts[some.episode]
        )
        drawn.append(
            {
                **named(plant, channel),
                "rms": {layer: number(rms(m)) for layer, m in missed.items()},
                **maps(missed, places),
            }
        )
    return drawn


def _experiment(diagnosis: Diagnosis) -> Json:
    """The command of the next experiment, if there is one."""
    plant, next_ = diagnosis.plant, diagnosis.experiment
    if next_ is None or next_.command is None:
        return None
    drawn = slice(None, None, max(1, math.ceil(len(next_.t_s) / MOST)))
    commands: list[Json] = [
        {**named(plant, c), "issued": numbers(next_.command[drawn, plant.joint_of(c)])}
        for c in plant.layout.commands
    ]
    return {"t_s": numbers(next_.t_s[drawn]), "commands": commands}
