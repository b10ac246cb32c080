"""Make a case folder from recordings alone, of any format.

The signals are found or taken as they were told, the last part of what was recorded is held out,
and a first model is identified, or taken from an MJCF or URDF. What the recordings declare of
themselves is kept: a recording that declares its role is copied as it is.
"""

from __future__ import annotations

import json
import re
import shutil
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from trueup.doctor.examine import examine
from trueup.doctor.finding import Finding
from trueup.episode.episode import Episode
from trueup.episode.layout import Layout
from trueup.episode.mcap import read_episode
from trueup.episode.role import Role
from trueup.errors import BadPlant, of_file
from trueup.fit.first_model import describe, describe_robot
from trueup.model.mjcf import compile_file
from trueup.model.nominal_form import resolved
from trueup.model.plant import Plant
from trueup.recording.asked import Asked
from trueup.recording.format import Run
from trueup.recording.guess import guess
from trueup.recording.mapping import MAPPING_FILE, Part, SignalMapping, layout_of
from trueup.recording.parts import RecordingPart, parts_of
from trueup.recording.transcribe import Origin, origins_of

JOINT_STATE = "JointState"
MODEL_SUFFIXES = (".xml", ".mjcf", ".urdf")
PLANT_FILE = "plant.json"
Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class Declared:
    """What a person declares of recordings; the rest is found. `name` is the plant's; `mapping`
    says which signals are meant, else `asked` and their names do; `model` is an MJCF or URDF
    file. A whole plant.json as `plant`, with what the files that it names hold, leaves no model to
    find."""

    name: str
    family: str | None = None
    stage: str = "physical"
    asked: Asked = field(default_factory=Asked)
    mapping: SignalMapping | None = None
    model: Path | None = None
    plant: dict[str, Any] | None = None


@dataclass(frozen=True)
class MadeCase:
    """A case folder that was made: its plant.json, the mapping that it was made by, its episodes'
    roles, whether the recordings declared them, and what looks wrong with the log; and the plant
    and the episodes as they are read from there, in the order of their `files`."""

    folder: Path
    document: dict[str, Any]
    mapping: SignalMapping
    roles: Counter[Role]
    is_role_declared: bool
    stage: str
    findings: Sequence[Finding]
    plant: Plant
    files: Sequence[Path]
    episodes: Sequence[Episode]


def find_mapping(runs: Sequence[Run], declared: Declared) -> SignalMapping:
    """The mapping of signals to channels: the declared one, or what names and units tell. Raises
    BadEpisode, BadMapping, BadPlant."""
    joints = compile_file(declared.model).tree.joints if declared.model else None
    layout = Plant.from_document(declared.plant).layout if declared.plant else None
    with of_file(runs[0].path.name):
        mapping = declared.mapping or guess(
            runs[0].recording, declared.asked, joints=joints, layout=layout
        )
        mapping.require(runs[0].recording)
    return mapping


def make_case(
    runs: Sequence[Run],
    out: Path,
    mapping: SignalMapping,
    declared: Declared,
    progress: Progress = lambda _stage, _part: None,
) -> MadeCase:
    """Make a case folder from the signals that `mapping` names. Raises BadEpisode, BadMapping,
    BadPlant, NotIdentifiable."""
    progress("looking through the recordings", 0.0)
    layout = (
        layout_of(mapping, _topics(runs[0], mapping))
        if declared.plant is None
        else Plant.from_document(declared.plant).layout
    )
    out.mkdir(parents=True, exist_ok=True)
    for earlier in out.glob("*.mcap"):  # of a case that was made here before
        earlier.unlink()
    origins = origins_of(runs)
    parts = parts_of([run.recording for run in runs], mapping)
    paths = []
    for i, part in enumerate(parts):
        progress(f"writing episode {i + 1} of {len(parts)}", 0.1 + 0.5 * i / len(parts))
        to = out / f"{i}-{part.role}.mcap"
        run, origin = runs[part.index], origins[part.index]
        paths.append(_write(run, part, mapping, layout, to, declared.stage, origin))
    progress("identifying a first model", 0.6)
    episodes = [_read(path, layout) for path in paths]
    document = _document(declared, layout, episodes, out)
    (out / PLANT_FILE).write_text(json.dumps(document, indent=1, ensure_ascii=False) + "\n")
    (out / MAPPING_FILE).write_text(json.dumps(mapping.document(), indent=1) + "\n")
    progress("looking for faults in the log", 0.9)
    plant = Plant.from_document(resolved(document, out))
    episodes = [replace(e, layout=plant.layout) for e in episodes]
    return MadeCase(
        out,
        document,
        mapping,
        Counter(e.role for e in episodes),
        runs[0].recording.role is not None,
        declared.stage,
        examine(plant, episodes),
        plant,
        paths,
        episodes,
    )


def model_beside(path: Path) -> Path | None:
    """The one MJCF or URDF in a folder of recordings, or beside a file; None where there is none or
    several."""
    folder = path if path.is_dir() else path.parent
    models = [p for p in sorted(folder.iterdir()) if p.suffix in MODEL_SUFFIXES]
    return models[0] if len(models) == 1 else None


def plain_name(text: str) -> str:
    """A plant's name made of any text: small letters, digits, dashes and underscores."""
    return re.sub(r"[^a-z0-9_-]+", "-", text.lower()).strip("-_")[:63] or "robot"


def _write(
    run: Run,
    part: RecordingPart,
    mapping: SignalMapping,
    layout: Layout,
    to: Path,
    stage: str,
    origin: Origin,
) -> Path:
    with of_file(run.path.name):
        if run.recording.role is not None:
            shutil.copyfile(run.path, to)
            return to
        conditions = {"stage": stage, "recording": run.part or run.path.name}
        with to.open("wb") as file:
            part.write(file, mapping, layout, conditions, origin)
    return to


def _read(path: Path, layout: Layout) -> Episode:
    with of_file(path.name):
        return read_episode(path.read_bytes(), layout)


def _topics(run: Run, mapping: SignalMapping) -> dict[str, str]:
    """The topics of the plant: the log's own where they carry JointState, so that its other
    recordings are episodes as they are."""
    topics = {}
    for what, part in (("observation", Part.OBSERVATIONS), ("command", Part.COMMANDS)):
        stream = run.recording.stream(mapping.of(part)[0].stream)
        if stream is not None and stream.kind.endswith(JOINT_STATE):
            topics[what] = stream.name
    return topics


def _document(
    declared: Declared, layout: Layout, episodes: Sequence[Episode], out: Path
) -> dict[str, Any]:
    if declared.plant is not None:
        return declared.plant
    plain = plain_name(declared.name)
    if not any(e.role is Role.ADAPTATION for e in episodes):
        raise BadPlant(
            "no recording has the role adaptation, and nothing can be identified",
            field="role",
        )
    if declared.model is None:
        return describe(plain, layout, episodes, declared.family)
    if declared.model.resolve() != (out / declared.model.name).resolve():
        shutil.copyfile(declared.model, out / declared.model.name)
    return describe_robot(plain, layout, episodes, declared.model.name)
