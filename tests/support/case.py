"""Case folders: a plant.json and the recordings of a machine whose faults are known."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from tests.support.made import T0_NS
from tests.support.simulated import recorded_twice
from trueup.episode.episode import Episode
from trueup.episode.writer import write_episode
from trueup.model.plant import Plant

APART_NS = 10**12  # from the start of one recording to that of the next


def write_recording(path: Path, episode: Episode, start_ns: int = T0_NS) -> Path:
    """Writes an episode as MCAP, and returns its path."""
    with path.open("wb") as file:
        write_episode(
            file,
            stamps_ns=start_ns + np.rint(episode.t_s * 1e9).astype(np.int64),
            observations=episode.observations,
            commands=episode.commands,
            layout=episode.layout,
            role=episode.role,
            conditions=episode.conditions,
        )
    return path


def write_recordings(folder: Path, episodes: Iterable[Episode]) -> list[Path]:
    """Writes episodes as `0-adaptation.mcap`, `1-validation.mcap`, …, and returns their paths."""
    return [
        write_recording(folder / f"{i}-{e.role}.mcap", e, T0_NS + i * APART_NS)
        for i, e in enumerate(episodes)
    ]


def write_case(folder: Path, plant: Plant, episodes: Iterable[Episode]) -> list[Path]:
    """Writes a case folder, and returns the paths of its recordings."""
    (folder / "plant.json").write_text(json.dumps(dict(plant.document)))
    return write_recordings(folder, episodes)


def write_friction_case(folder: Path, seed: int = 11) -> Plant:
    """Writes the case of a joint with Coulomb friction, which is diagnosed in about a second; each
    seed makes other recordings.

    Returns its plant.
    """
    plant, episodes, _ = recorded_twice("A1", ["coulomb_friction"], seed)
    write_case(folder, plant, episodes)
    return plant
