"""Case: a plant and what was recorded of it, from tables in memory, from files or from a folder."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from io import BytesIO
from os import PathLike
from pathlib import Path
from typing import Any

from trueup.diagnose.case import read_case
from trueup.diagnose.make_case import PLANT_FILE
from trueup.doctor.examine import examine
from trueup.doctor.finding import Finding
from trueup.episode.episode import Episode
from trueup.episode.layout import Layout
from trueup.episode.mcap import read_episode
from trueup.episode.role import Role
from trueup.errors import NotAnEpisode
from trueup.model.plant import Plant
from trueup.notebook.models import FirstModel, NominalModel
from trueup.recording.asked import Asked
from trueup.recording.controllers import read_controllers
from trueup.recording.format import open_runs
from trueup.recording.guess import guess
from trueup.recording.in_memory import table_recording
from trueup.recording.mapping import MAPPING_FILE, SignalMapping, layout_of, read_mapping
from trueup.recording.parts import RecordingPart, parts_of
from trueup.recording.recording import Clock, Recording
from trueup.recording.transcribe import Origin, origins_of

IN_MEMORY = Origin("table in memory", "0" * 64)


@dataclass(frozen=True)
class Case:
    """A plant and its episodes. `mapping` says which signals they were made from, None where they
    were episodes already; `files` are the episodes as MCAP, in the same order."""

    plant: Plant
    episodes: tuple[Episode, ...]
    mapping: SignalMapping | None = None
    files: tuple[bytes, ...] = ()

    @staticmethod
    def from_table(
        tables: Any,
        *,
        plant: NominalModel | None = None,
        q: str | None = None,
        v: str | None = None,
        u: str | None = None,
        t: str | None = None,
        t_unit: str | None = None,
        rate_hz: float | None = None,
        units: Mapping[str, str] | None = None,
        roles: Sequence[str] | None = None,
        stage: str = "physical",
        mapping: Mapping[str, Any] | None = None,
    ) -> Case:
        """A case from one table or a list of them, each a run.

        A table is a pandas, polars or Arrow table, a structured array, or a mapping of arrays
        `(samples,)`. `q`, `v`, `u` and `t` name the columns of the position, the velocity, the
        command and the time; what is not named is told by names and units, as is `units`, by `q`,
        `v` and `u`. Without a time, rows are `rate_hz` [Hz] apart. A whole `mapping` says all of
        that at once. `plant` is the nominal model; without it the simplest that the data allow is
        identified. `roles` are `adaptation` or `validation` for each table; by default the last
        30 % of the tables are held out, and of a single table its end. `stage` is where it was
        recorded: MIL, SIL, PIL, HIL or physical. Raises BadEpisode, BadMapping, BadPlant,
        NotIdentifiable.
        """
        listed = tables if isinstance(tables, list | tuple) else [tables]
        if not listed:
            raise NotAnEpisode("there is no table", rule="samples")
        recordings = [table_recording(table, f"table {i}") for i, table in enumerate(listed)]
        asked = Asked(_named(q=q, v=v, u=u), dict(units or {}), clock=_clock(t, t_unit, rate_hz))
        return _made(recordings, [IN_MEMORY] * len(recordings), plant, asked, roles, stage, mapping)

    @staticmethod
    def from_recordings(
        path: str | PathLike[str] | Sequence[str | PathLike[str]],
        *,
        plant: NominalModel | None = None,
        joint: str | None = None,
        q: str | None = None,
        v: str | None = None,
        u: str | None = None,
        t: str | None = None,
        t_unit: str | None = None,
        rate_hz: float | None = None,
        units: Mapping[str, str] | None = None,
        names: Sequence[str] = (),
        controllers: str | PathLike[str] | None = None,
        observation: str | None = None,
        command: str | None = None,
        roles: Sequence[str] | None = None,
        stage: str = "physical",
        mapping: Mapping[str, Any] | None = None,
    ) -> Case:
        """A case from a file or a folder of any format that docs/recordings.md lists, or from
        several.

        `joint` names one of several; `q`, `v` and `u` name signals, where names do not tell;
        `observation` and `command` topics; `names` the joints of a list that has none, which
        `controllers`, a parameter file of ros2_control, lists as well. The rest is as for
        `from_table`. Raises BadEpisode, BadMapping, BadPlant, NotIdentifiable, NotInstalled.
        """
        paths = [path] if isinstance(path, str | PathLike) else path
        runs = [run for one in paths for run in open_runs(Path(one))]
        asked = Asked(
            _named(q=q, v=v, u=u),
            dict(units or {}),
            joint,
            observation,
            command,
            _clock(t, t_unit, rate_hz),
            tuple(names),
            read_controllers(Path(controllers)) if controllers is not None else {},
        )
        recordings = [run.recording for run in runs]
        return _made(recordings, origins_of(runs), plant, asked, roles, stage, mapping)

    @staticmethod
    def read(folder: str | PathLike[str]) -> Case:
        """The case in a folder with plant.json and MCAP episodes. Raises BadPlant, BadEpisode."""
        plant, episodes = read_case(Path(folder))
        return Case(plant, tuple(episodes))

    def save(self, folder: str | PathLike[str]) -> Path:
        """Write the case as a folder that the `trueup` command takes; returns the folder. Raises
        NotAnEpisode where the case was read from one."""
        if not self.files:
            raise NotAnEpisode("the case was read from a folder, which is it", rule="samples")
        to = Path(folder)
        to.mkdir(parents=True, exist_ok=True)
        (to / PLANT_FILE).write_text(json.dumps(dict(self.plant.document), indent=1) + "\n")
        if self.mapping is not None:
            (to / MAPPING_FILE).write_text(json.dumps(self.mapping.document(), indent=1) + "\n")
        for i, (episode, data) in enumerate(zip(self.episodes, self.files, strict=True)):
            (to / f"{i}-{episode.role}.mcap").write_bytes(data)
        return to

    @property
    def findings(self) -> list[Finding]:
        """What looks wrong with the log before anything is blamed on the machine."""
        return examine(self.plant, self.episodes)

    @property
    def guesses(self) -> tuple[str, ...]:
        """In words what of the signals nobody named, to be checked by eye."""
        return self.mapping.guesses if self.mapping else ()

    def __repr__(self) -> str:
        roles = ", ".join(
            f"{sum(e.role is role for e in self.episodes)} {role}"
            for role in Role
            if any(e.role is role for e in self.episodes)
        )
        guessed = f"; guessed: {'; '.join(self.guesses)}" if self.guesses else ""
        return f"Case({self.plant.name}, {self.plant.family}: {roles}{guessed})"


def _named(**signals: str | None) -> dict[str, str]:
    return {symbol: name for symbol, name in signals.items() if name is not None}


def _clock(t: str | None, unit: str | None, rate_hz: float | None) -> Clock | None:
    if t is None and unit is None and rate_hz is None:
        return None
    return Clock(t, unit or "", rate_hz)


def _made(
    recordings: Sequence[Recording],
    origins: Sequence[Origin],
    model: NominalModel | None,
    asked: Asked,
    roles: Sequence[str] | None,
    stage: str,
    document: Mapping[str, Any] | None,
) -> Case:
    model = model or FirstModel()
    if document is not None:
        mapping = read_mapping(json.dumps(document))
    else:
        mapping = guess(recordings[0], asked, joints=model.joints)
    mapping.require(recordings[0])
    layout = layout_of(mapping, {})
    files = [
        _written(part, mapping, layout, stage, origins[part.index])
        for part in parts_of(recordings, mapping, roles)
    ]
    episodes = [read_episode(data, layout) for data in files]
    plant = model.plant(layout, episodes)
    return Case(
        plant,
        tuple(replace(e, layout=plant.layout) for e in episodes),
        mapping,
        tuple(files),
    )


def _written(
    part: RecordingPart, mapping: SignalMapping, layout: Layout, stage: str, origin: Origin
) -> bytes:
    stream = BytesIO()
    conditions = {"stage": stage, "recording": part.recording.name}
    part.write(stream, mapping, layout, conditions, origin)
    return stream.getvalue()
