"""A designed excitation as files to play, and as a report with what is drawn of it."""

from __future__ import annotations

import json
from io import BytesIO
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trueup.canonical import Json, digest_of
from trueup.collect.bounds import UNBOUNDED
from trueup.collect.checklist import command_table
from trueup.diagnose.between_recordings import named
from trueup.diagnose.excitation_design import Design
from trueup.episode.writer import write_episode

Array = NDArray[np.float64]
COMMAND_CSV, COMMAND_MCAP, DESIGN_FILE = "excitation.csv", "excitation.mcap", "excitation.json"
MEDIA_TYPES = {
    COMMAND_CSV: "text/csv",
    COMMAND_MCAP: "application/octet-stream",
    DESIGN_FILE: "application/json",
}
DRAWN = 600  # points of a line


def excitation_files(designed: Design) -> dict[str, bytes]:
    """The files by name: the command as CSV, whose first lines say what to check, and as MCAP
    (commands alone); and the design as JSON."""
    plant, excitation, document = designed.plant, designed.excitation, dict(designed.document)
    mcap = BytesIO()
    write_episode(
        mcap,
        stamps_ns=np.rint(excitation.t_s * 1e9).astype(np.int64),
        observations=np.zeros((0, len(plant.layout.observations))),
        commands=excitation.command[:, [plant.joint_of(c) for c in plant.layout.commands]],
        layout=plant.layout,
        role=None,
        conditions={"plant": plant.name, "excitation": digest_of(document)},
    )
    table = command_table(plant, excitation.t_s, excitation.command, designed.check_first)
    return {
        COMMAND_CSV: table.encode(),
        COMMAND_MCAP: mcap.getvalue(),
        DESIGN_FILE: (json.dumps(document, indent=1) + "\n").encode(),
    }


def excitation_report(designed: Design) -> dict[str, Any]:
    """The design as a report: its document, the digest by which a recording of it names it, each
    figure beside that of random excitations, and under `drawn` the command and the motion."""
    excitation, document = designed.excitation, dict(designed.document)
    others, units = dict(excitation.random.information.rows()), _units(designed)
    return {
        **document,
        "excitation": digest_of(document),
        "title": excitation.title,
        "figures": [
            {
                "what": name,
                "unit": measure,
                "designed": _finite(value * factor),
                "random": _finite(others[name] * factor),
            }
            for name, value in excitation.information.rows()
            for measure, factor in [units.get(name, ("", 1.0))]
        ],
        "not_parted": list(designed.not_parted),
        "drawn": _drawn(designed),
    }


def _units(designed: Design) -> dict[str, tuple[str, float]]:
    """The declared unit of each number of the models in play, and how many of it one of the
    number's own is."""
    plant, units = designed.plant, {}
    of = [("", name, name) for name in plant.nominal]
    for ensemble in designed.play.ensembles:
        of += [
            (term, number, f"{plant.term_words(term)} {number}")
            for term in ensemble.hypothesis.effects
            for number in plant.block.rows_of(term)
        ]
    for term, number, name in of:
        described, factor = named(plant, term, number)
        units[name] = (str(described["unit"]), factor)
    return units


def _drawn(designed: Design) -> dict[str, Json]:
    """The command, and for each observation the range of its motion under every model and the
    motion of each composition's central model; bounds are null where there are none."""
    plant, excitation = designed.plant, designed.excitation
    every = slice(None, None, max(1, -(-len(excitation.t_s) // DRAWN)))
    kept, sources = excitation.bounds.whole(), excitation.bounds.sources
    commands: list[Json] = [
        {
            "name": channel.name,
            "unit": channel.unit,
            "limits": None if channel.limits is None else [float(x) for x in channel.limits],
            "values": _list(excitation.command[every, plant.joint_of(channel)]),
        }
        for channel in plant.layout.commands
    ]
    observations: list[Json] = []
    for channel, column in zip(plant.layout.observations, plant.state_columns, strict=True):
        paths = excitation.paths[:, every, column]
        observations.append(
            {
                "name": channel.name,
                "unit": channel.unit,
                "bounds": None if sources[column] == UNBOUNDED else _list(kept[column]),
                "low": _list(paths.min(axis=0)),
                "high": _list(paths.max(axis=0)),
                "central": {name: _list(paths[i]) for name, i in excitation.central.items()},
            }
        )
    return {
        "t_s": _list(excitation.t_s[every]),
        "commands": commands,
        "observations": observations,
    }


def _list(values: Array) -> list[Json]:
    return [float(x) for x in values]


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
