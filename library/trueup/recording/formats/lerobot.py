"""LeRobotDataset, version 3: a folder of Parquet files with a description of its features.

Each episode is a run. `observation.state` and `action` are columns of lists, whose entries
`meta/info.json` names; videos and images are not read. Frames are taken to be as far apart as the
declared rate says wherever the logged times agree with it: they are 32-bit numbers, which at 100 s
are off by some microseconds.
Source: huggingface/lerobot, `lerobot.datasets`, codebase version v3.0 (2026).
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trueup.episode.container import Limits
from trueup.errors import MalformedRecording, NotAnEpisode
from trueup.recording.format import Format, optional
from trueup.recording.parquet_table import ParquetTable
from trueup.recording.recording import Clock
from trueup.recording.table import TableRecording

INFO, DATA = "meta/info.json", "data/*/*.parquet"
VERSION = "v3"
OWN = ("timestamp", "frame_index", "episode_index", "index", "task_index")
ANGLES = "deg"  # of its drivers, unless they were told to normalise a joint's range to +-100
TOLERANCE_S = 1e-4  # LeRobot's own, for times that should be a whole number of frames


class LeRobot(Format):
    """A dataset's folder, as `lerobot-record` leaves it or a hub's copy of it."""

    name = "lerobot"
    suffixes = ("meta/info.json",)

    def knows(self, path: Path, head: bytes) -> bool:
        return path.is_dir() and (path / INFO).is_file() and (path / "data").is_dir()

    def recordings(self, path: Path, limits: Limits) -> Sequence[TableRecording]:
        info = _info(path)
        files = sorted(path.glob(DATA))
        if not files:
            raise NotAnEpisode(f"{path} holds no data/*/*.parquet", rule="format")
        rate, names = float(info["fps"]), _names(info)
        return [
            _run(f"{path.name}/episode {number}", files, limits, rows, names, rate)
            for number, rows in _episodes(files)
        ]


def _info(path: Path) -> dict[str, Any]:
    try:
        info = json.loads((path / INFO).read_text())
        version, features = str(info["codebase_version"]), info["features"]
        rate = float(info["fps"])
    except (ValueError, KeyError, TypeError) as error:
        raise MalformedRecording(f"{INFO} cannot be read: {error}", rule="container") from error
    if not version.startswith(VERSION):
        raise NotAnEpisode(
            f"the dataset is of version {version}, version 3 is read",
            rule="format",
            hint="Convert it with `python -m lerobot.scripts.convert_dataset_v21_to_v30`.",
        )
    if not isinstance(features, dict) or not rate > 0.0:
        raise MalformedRecording(f"{INFO} declares no features or no rate", rule="container")
    return dict(info)


def _names(info: Mapping[str, Any]) -> dict[str, list[str]]:
    """What the entries of each feature are called, as `[shoulder_pan.pos]`."""
    names = {}
    for feature, description in info["features"].items():
        own = description.get("names") if isinstance(description, dict) else None
        if isinstance(own, dict):  # grouped by what they are of: {"motors": [...]}
            own = [n for group in own.values() if isinstance(group, list) for n in group]
        if isinstance(own, list) and all(isinstance(n, str) for n in own):
            names[str(feature)] = [f"[{n}]" for n in own]
    return names


def _episodes(files: Sequence[Path]) -> list[tuple[int, slice]]:
    """The number of each episode, and its rows in all files together."""
    parquet = optional("pyarrow.parquet", "lerobot", "a LeRobot dataset")
    try:
        of = [parquet.read_table(f, columns=["episode_index"]).column(0).to_numpy() for f in files]
    except (OSError, ValueError, KeyError) as error:
        raise MalformedRecording(f"the dataset cannot be read: {error}", rule="container") from None
    numbers = np.concatenate(of)
    starts = np.flatnonzero(np.append(True, np.diff(numbers) != 0))
    ends = np.append(starts[1:], len(numbers))
    return [(int(numbers[a]), slice(int(a), int(b))) for a, b in zip(starts, ends, strict=True)]


def _run(
    name: str,
    files: Sequence[Path],
    limits: Limits,
    rows: slice,
    names: Mapping[str, Sequence[str]],
    rate: float,
) -> TableRecording:
    table = ParquetTable(files, limits, rows, names)
    columns = [c for c in table.columns if c not in OWN or c == "timestamp"]

    def blocks(wanted: Sequence[str]) -> Iterator[Mapping[str, NDArray[Any]]]:
        read = [*wanted, *(["frame_index"] if "timestamp" in wanted else [])]
        for block in table.blocks(read):
            kept = {n: block[n] for n in wanted}
            if "timestamp" in wanted:
                exact = np.asarray(block["frame_index"], np.float64) / rate
                logged = np.asarray(block["timestamp"], np.float64)
                agree = np.abs(exact - logged).max(initial=0.0) <= TOLERANCE_S
                kept["timestamp"] = exact if agree else logged
            yield kept

    clock = Clock("timestamp", "s")
    return TableRecording(name, LeRobot.name, columns, blocks, clock, ANGLES)


FORMAT = LeRobot()
