"""`trueup upload`: send recordings to a service."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

from cyclopts import Parameter

from trueup.episode.layout import Layout
from trueup.episode.role import Role
from trueup.errors import NotAnEpisode, of_file
from trueup.model.plant import Plant
from trueup.recording.format import format_of, open_runs
from trueup.recording.guess import guess
from trueup.recording.mapping import read_mapping
from trueup.recording.transcribe import origins_of, transcribe
from trueup_cli.options import DEFAULT_URL, Json, PlantName, Url, connect
from trueup_cli.show import Bar, as_json, progress, say, table
from trueup_cli.signals import confirmed
from trueup_client.problem import Problem

SENDING = 0.9  # share of the bar for sending; the rest is the inspection by the service


def upload(
    plant: PlantName,
    *files: Path,
    role: Annotated[
        Role | None,
        Parameter(help="What the recordings are for, where they do not say it themselves"),
    ] = None,
    stage: Annotated[
        str | None, Parameter(help="MIL, SIL, PIL, HIL or physical: where they were recorded")
    ] = None,
    mapping: Annotated[
        Path | None, Parameter(help="File that says which signals are meant, as `init` writes it")
    ] = None,
    url: Url = DEFAULT_URL,
    as_json_: Json = False,
) -> None:
    """Upload recordings of any format. The same file again is the same episode.

    MCAP files that declare their role are sent as they are. Others need --role; they are turned
    into MCAP here, with the original's SHA-256 in it.

    Parameters
    ----------
    files
        files, or folders that hold some: MCAP, ROS bags, CSV, Parquet, HDF5, npz, LeRobot
    """
    client = connect(url)
    if not files:
        raise NotAnEpisode(
            "nothing to upload was named",
            rule="samples",
            hint="Name recordings, or folders that hold some.",
        )
    uploaded, names = [], []
    with TemporaryDirectory() as made:
        if role is None:
            paths = [(path.name, path) for file in files for path in _recordings(file)]
        else:
            described = _Described(role, {"stage": stage} if stage else {}, mapping)
            layout = Plant.from_document(client.plant(plant)["document"]).layout
            paths = [
                episode
                for file in files
                for episode in _transcribed(file, layout, described, Path(made))
            ]
        for name, path in paths:
            with progress(f"upload {name}") as bar:
                try:
                    uploaded.append(client.upload_episode(plant, path, partial(_show_sent, bar)))
                except Problem as problem:
                    problem.facts.setdefault("file", name)
                    raise
            names.append(name)
    if as_json_:
        as_json(uploaded)
    else:
        warned = Counter(
            warning
            for episode in uploaded
            for warning in episode["summary"].get("collection", {}).get("warnings", [])
        )
        for warning, times in warned.items():
            say("[yellow]{} of {} episodes[/]: {}", times, len(uploaded), warning)
        if warned:
            say(
                "[dim]Declare what is missing in the recording's metadata record `episode`, or in "
                "plant.json: docs/plant.md.[/]"
            )
        table(
            "Episodes",
            ["file", "digest", "role", "samples", "seconds"],
            [
                (
                    name,
                    e["digest"][:12],
                    e["role"],
                    e["summary"]["samples"],
                    e["summary"]["duration_s"],
                )
                for name, e in zip(names, uploaded, strict=True)
            ],
        )


@dataclass(frozen=True)
class _Described:
    """What is said of recordings beside their bytes."""

    role: Role
    conditions: dict[str, str]
    mapping: Path | None


def _transcribed(
    path: Path, layout: Layout, described: _Described, to: Path
) -> Iterator[tuple[str, Path]]:
    """Yields the name of every run in a file or folder, and the episode that was made of it."""
    runs = open_runs(path)
    declared = read_mapping(described.mapping.read_bytes()) if described.mapping else None
    mapping = declared or guess(runs[0].recording, layout=layout)
    if declared is None:
        mapping = confirmed(mapping)
    for run, origin in zip(runs, origins_of(runs), strict=True):
        name = run.part or run.path.name
        episode = to / f"{len(list(to.iterdir()))}.mcap"
        with progress(f"reading {name}"), of_file(name), episode.open("xb") as file:
            transcribe(
                run.recording,
                mapping,
                layout,
                file,
                role=described.role,
                conditions={**described.conditions, "recording": name},
                origin=origin,
            )
        yield name, episode


def _recordings(path: Path) -> list[Path]:
    """Returns the MCAP files that a path names. Raises NotAnEpisode if they are of another
    format, which do not say what they are for."""
    files = sorted(path.glob("*.mcap")) if path.is_dir() else [path]
    if not files or any(format_of(file).name != "mcap" for file in files):
        what = f"{path} holds no *.mcap" if not files else f"{path.name} is no MCAP file"
        raise NotAnEpisode(
            f"{what}, and other recordings do not say what they are for",
            rule="role",
            hint=f"Give --role, one of {', '.join(Role)}.",
        )
    return files


def _show_sent(bar: Bar, share: float) -> None:
    bar(SENDING * share, "sending" if share < 1.0 else "inspecting")
