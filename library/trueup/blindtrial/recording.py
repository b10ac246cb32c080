"""Recording: a machine's runs as the files of a case for the diagnosis, and as test episodes that
it never sees."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from io import BytesIO

import numpy as np
from mcap.writer import CompressionType
from numpy.typing import NDArray

from trueup.canonical import canonical_bytes
from trueup.episode.episode import Episode
from trueup.episode.role import Role
from trueup.episode.writer import write_episode
from trueup.model.plant import Plant
from trueup.simulate.machine import Run
from trueup.simulate.trial import SimulatedTrial


def case_files(
    plant: Plant, trial: SimulatedTrial, conditions: Mapping[str, str]
) -> dict[str, bytes]:
    """plant.json and the adaptation and validation recordings, by file name. The recordings are not
    compressed, so that their bytes can be searched for a leaked label."""
    files = {"plant.json": canonical_bytes(dict(plant.document))}
    for role in (Role.ADAPTATION, Role.VALIDATION):
        for i, run in enumerate(trial.of(role)):
            files[f"{role}-{i}.mcap"] = _mcap(plant, run, role, conditions)
    return files


def _mcap(plant: Plant, run: Run, role: Role, conditions: Mapping[str, str]) -> bytes:
    stream = BytesIO()
    write_episode(
        stream,
        stamps_ns=np.rint(run.t_s * 1e9).astype(np.int64),
        observations=run.observed[:, plant.state_columns],
        commands=_commands(plant, run),
        layout=plant.layout,
        role=role,
        conditions=conditions,
        compression=CompressionType.NONE,
    )
    return stream.getvalue()


def held_out_episodes(plant: Plant, trial: SimulatedTrial) -> list[Episode]:
    """The test recordings: they measure a correction, and no diagnosis sees them."""
    return [
        Episode(
            run.t_s.copy(),
            _commands(plant, run),
            run.observed[:, plant.state_columns].copy(),
            plant.layout,
            Role.TEST,
            {},
            0,
            f"test-{i}",
        )
        for i, run in enumerate(trial.of("test"))
    ]


def _commands(plant: Plant, run: Run) -> NDArray[np.float64]:
    """The joints' commands as the log has them, `(samples, commands)`."""
    by_joint = run.issued.reshape(len(run.t_s), -1)
    return by_joint[:, [plant.joint_of(c) for c in plant.layout.commands]]


def conditions_of(episodes: Sequence[Episode]) -> dict[str, str]:
    """The collection conditions that all of the user's episodes share. A trial's recordings declare
    them too."""
    shared = dict(episodes[0].conditions)
    for e in episodes[1:]:
        shared = {k: v for k, v in shared.items() if e.conditions.get(k) == v}
    return shared
