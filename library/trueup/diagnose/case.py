"""A case folder: plant.json and its episodes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import orjson

from trueup.episode.episode import Episode
from trueup.episode.mcap import read_episode_stream
from trueup.errors import BadPlant, NotAnEpisode, of_file
from trueup.model.nominal_form import resolved
from trueup.model.plant import Plant


def read_case(folder: Path) -> tuple[Plant, list[Episode]]:
    """The plant and every episode of a case folder, in the order of their file names. Raises
    BadPlant, BadEpisode."""
    plant = read_plant(folder)
    episodes = read_episodes(folder, plant)
    if not episodes:
        raise NotAnEpisode(f"{folder} holds no *.mcap episode", rule="samples")
    return plant, episodes


def read_episodes(folder: Path, plant: Plant) -> list[Episode]:
    """Every episode of a case folder, in the order of their file names. Raises BadEpisode."""
    return [read_recording(file, plant) for file in recordings_of(folder)]


def names_of(folder: Path, episodes: Sequence[Episode]) -> dict[str, str]:
    """What the episodes of a case folder are called, by digest: as they were recorded, else by
    their files."""
    files = zip(episodes, recordings_of(folder), strict=True)
    return {e.digest: e.name or file.stem for e, file in files}


def recordings_of(folder: Path) -> list[Path]:
    """The recordings of a case folder, in the order of their names."""
    return sorted(folder.glob("*.mcap"))


def read_plant(folder: Path) -> Plant:
    """The plant of a case folder. Raises BadPlant."""
    description = folder / "plant.json"
    if not folder.is_dir():
        raise BadPlant(
            f"there is no folder {folder}",
            field="plant.json",
            hint="Name a case folder, a recording or a ROS 2 bag.",
        )
    if not description.is_file():
        raise BadPlant(
            f"{folder} holds no plant.json",
            field="plant.json",
            hint="A case is a folder with plant.json and *.mcap episodes.",
        )
    try:
        document = orjson.loads(description.read_bytes())
    except orjson.JSONDecodeError as error:
        raise BadPlant(f"{description} is not JSON: {error}", field="plant.json") from error
    return Plant.from_document(resolved(document, folder))


def read_recording(file: Path, plant: Plant, late_s: float = 0.0) -> Episode:
    """The episode in a file, whose observations happened `late_s` [s] before their stamps. Raises
    BadEpisode."""
    with of_file(file.name), file.open("rb") as stream:
        return read_episode_stream(stream, file.stat().st_size, plant.layout, late_s=late_s)
