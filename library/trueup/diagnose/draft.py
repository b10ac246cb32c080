"""Draft: the plant and the episodes that received files propose, before anybody registers them.

What is received is one file: a recording of any format, a plant.json, or a zip archive of several
files, among them a plant.json, or an MJCF or URDF with its meshes.

- A plant.json is taken as it is, and recordings beside it become its episodes.
- Without one, a plant.json is made of the recordings, as `trueup init` does.
- No received model names a file outside of what was received, nor do the files that it includes.
- What was received and is not used is listed.
- Where names do not tell which signals are meant, the draft says what is missing and which signals
  there are, and nothing is made. So too where no model can be identified from them.
"""

from __future__ import annotations

import shutil
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
import orjson

from trueup.canonical import Json
from trueup.diagnose.make_case import (
    MODEL_SUFFIXES,
    PLANT_FILE,
    Declared,
    MadeCase,
    find_mapping,
    make_case,
    plain_name,
)
from trueup.doctor.finding import documents
from trueup.episode.container import LIMITS, Limits
from trueup.episode.episode import Episode
from trueup.errors import BadMapping, BadPlant, NotIdentifiable, TrueupError
from trueup.model.nominal_form import resolved
from trueup.model.plant import Plant
from trueup.recording.archive import unpacked
from trueup.recording.asked import Asked
from trueup.recording.format import Run, holds_recordings, open_runs
from trueup.recording.mapping import SignalMapping, read_mapping
from trueup.recording.recording import Clock

GATE_FILE = "gate.json"
PREVIEW_SAMPLES = 400  # of a signal, enough for a picture of 800 pixels
MOST_NAME = 255  # characters of a file's name
MOST_UNUSED = 20  # files that a draft lists
NESTED = ("include", "model")  # elements of a model that name another model
# what lies beside recordings and is none
BESIDE = (".xml", ".mjcf", ".urdf", ".json", ".md", ".txt", ".stl", ".obj", ".msh", ".dae", ".png")
MOST_SIGNALS = 500  # that a person chooses from


@dataclass(frozen=True, slots=True)
class Wishes:
    """What a person says of received files; the rest is found. `signals` and `units` are by `q`,
    `v`, `u`; `plant` is a plant.json that takes the place of the found one."""

    name: str | None = None
    family: str | None = None
    stage: str = "physical"
    joint: str | None = None
    signals: Mapping[str, str] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    time: str | None = None
    time_unit: str | None = None
    rate_hz: float | None = None
    mapping: str | None = None
    plant: Mapping[str, Any] | None = None


def draft_of(received: Path, out: Path, wishes: Wishes, limits: Limits = LIMITS) -> dict[str, Json]:
    """The draft of a received file, as JSON; its episodes are written into the folder `out`.

    `plant` is the plant.json, or None with a `problem` where a person must first say which signals
    are meant; `signals` lists those to choose from. Raises BadEpisode, BadMapping, BadPlant,
    NotInstalled.
    """
    with unpacked(received, limits) as opened:
        if opened.is_dir():
            _require_enclosed(opened)
        document = _declared_plant(opened, wishes)
        if document is not None and not _has_recordings(opened):
            Plant.from_document(document).require_known_envelope()
            return {**_nothing(opened, wishes), "plant": document}
        model = _model(opened)
        runs = open_runs(opened, limits)
        if model is not None:  # which names its meshes from where it lies
            shutil.copytree(opened, out, ignore=_recordings_in)
        declared = Declared(
            wishes.name or received.stem,
            wishes.family,
            wishes.stage,
            _asked(wishes),
            read_mapping(wishes.mapping) if wishes.mapping else None,
            None if wishes.joint or wishes.family or document else model,
            document,
        )
        try:
            mapping = find_mapping(runs, declared)
            made = make_case(runs, out, mapping, declared)
            return {**_made(made, runs, wishes), "unused": _unused(opened, runs)}
        except (BadMapping, NotIdentifiable) as error:  # which other signals may mend
            return {**_nothing(opened, wishes), **_choice(runs), "problem": _problem(error)}


def _declared_plant(opened: Path, wishes: Wishes) -> dict[str, Any] | None:
    """The plant.json among the received files, or the one wished for, with what the files that it
    names hold; None where there is none."""
    file = opened / PLANT_FILE if opened.is_dir() else opened
    if wishes.plant is not None:
        document: Any = dict(wishes.plant)
    elif file.suffix == ".json" and file.is_file():
        try:
            document = orjson.loads(file.read_bytes())
        except orjson.JSONDecodeError as error:
            raise BadPlant(f"{file.name} is not JSON: {error}", field=PLANT_FILE) from error
    else:
        return None
    folder = opened if opened.is_dir() else opened.parent
    _require_own_model(document)
    document = resolved(document, folder)
    if wishes.name is not None and isinstance(document, dict):
        document = {**document, "name": plain_name(wishes.name)}
    Plant.from_document(document)
    return dict(document)


def _has_recordings(opened: Path) -> bool:
    """Whether anything was received beside a description of the plant."""
    return holds_recordings(opened) if opened.is_dir() else opened.suffix != ".json"


def _model(opened: Path) -> Path | None:
    """The MJCF or URDF among the received files, that no other one includes. Raises BadPlant where
    it is alone, or there are several."""
    if opened.is_file():
        if opened.suffix in MODEL_SUFFIXES:
            raise BadPlant(
                f"{opened.name} says nothing of commands, steps and topics",
                field="nominal.mjcf",
                hint="Send it together with a recording of the robot, or with its plant.json.",
            )
        return None
    models = [p for p in sorted(opened.iterdir()) if p.suffix in MODEL_SUFFIXES]
    included = {
        PurePosixPath(e.get("file", "")).name
        for p in models
        for e in _elements(p)
        if e.tag in NESTED
    }
    models = [p for p in models if p.name not in included]
    if len(models) > 1:
        raise BadPlant(
            f"there are several models: {', '.join(p.name for p in models)}",
            field="nominal.mjcf",
            hint="Send one, or a plant.json that names it.",
        )
    return models[0] if models else None


def _require_own_model(document: Any) -> None:
    """Raises BadPlant where a plant.json names a model by a path that leads out of the folder, or
    that is no model's."""
    nominal = document.get("nominal") if isinstance(document, dict) else None
    name = nominal.get("mjcf") if isinstance(nominal, dict) else None
    if not isinstance(name, str):
        return
    if len(name) > MOST_NAME or not _stays_inside(name) or Path(name).suffix not in MODEL_SUFFIXES:
        raise BadPlant(
            "mjcf must name an .xml, .mjcf or .urdf file in the folder of plant.json",
            field="nominal.mjcf",
        )


def _require_enclosed(folder: Path) -> None:
    """Raises BadPlant where a received model names a file that lies outside of what was received,
    or another model that is not looked at here."""
    for model in sorted(p for p in folder.rglob("*") if p.suffix in MODEL_SUFFIXES):
        for element in _elements(model):
            for attribute, value in element.attrib.items():
                if not attribute.lower().startswith("file") and not attribute.endswith("dir"):
                    continue
                inside = _stays_inside(value)
                hidden = element.tag in NESTED and Path(value).suffix not in MODEL_SUFFIXES
                if not inside or hidden:
                    raise BadPlant(
                        f"{model.name} names {value!r}, which lies outside of what was received"
                        if not inside
                        else f"{model.name} includes {value!r}, which is no .xml, .mjcf or .urdf",
                        field="nominal.mjcf",
                        hint="Send the files that a model names with it, and name them from there.",
                    )


def _stays_inside(name: str) -> bool:
    """Whether a path goes neither up nor to the root."""
    path = PurePosixPath(name.replace("\\", "/"))
    return not path.is_absolute() and ".." not in path.parts and "\0" not in name


def _elements(model: Path) -> list[ET.Element]:
    """The elements of an XML file, which is read in a bounded process. Raises BadPlant."""
    try:
        return list(ET.parse(model).iter())
    except ET.ParseError as error:
        raise BadPlant(f"{model.name} is not XML: {error}", field="nominal.mjcf") from error


def _recordings_in(folder: str, names: list[str]) -> list[str]:
    """Of the names in a folder those that are no part of a model, for `copytree`."""
    return [
        name
        for name in names
        if (Path(folder) / name).is_file() and not name.lower().endswith(BESIDE)
    ]


def _unused(opened: Path, runs: Sequence[Run]) -> list[Json]:
    """The received files that the draft does not use."""
    if opened.is_file():
        return []
    read = {run.path for run in runs}
    if opened in read:
        return []
    files = (p for p in sorted(opened.rglob("*")) if p.is_file() and p not in read)
    unused = [
        str(p.relative_to(opened))
        for p in files
        if not any(folder in read for folder in p.parents)
        and (not p.name.lower().endswith(BESIDE) or p.name == GATE_FILE)
    ]
    return [*unused[:MOST_UNUSED]]


def _asked(wishes: Wishes) -> Asked:
    clock = None
    if wishes.time or wishes.time_unit or wishes.rate_hz is not None:
        clock = Clock(wishes.time, wishes.time_unit or "", wishes.rate_hz)
    return Asked(dict(wishes.signals), dict(wishes.units), wishes.joint, clock=clock)


def _nothing(opened: Path, wishes: Wishes) -> dict[str, Json]:
    """A draft in which nothing was made of recordings."""
    return {
        "name": wishes.name or plain_name(opened.stem),
        "plant": None,
        "mapping": None,
        "episodes": [],
        "findings": [],
        "signals": [],
        "stage": wishes.stage,
        "is_role_declared": False,
        "preview": None,
        "problem": None,
        "unused": [],
    }


def _choice(runs: Sequence[Run]) -> dict[str, Json]:
    """The signals that a person may choose from."""
    names = [s.name for stream in runs[0].recording.streams for s in stream.signals]
    return {"signals": list(dict.fromkeys(names))[:MOST_SIGNALS]}


def _problem(error: TrueupError) -> Json:
    facts: dict[str, Any] = dict(error.facts)
    return {"code": error.code, "message": error.message, "hint": error.hint, "facts": facts}


def _made(case: MadeCase, runs: Sequence[Run], wishes: Wishes) -> dict[str, Json]:
    return {
        **_nothing(case.folder, wishes),
        **_choice(runs),
        "name": case.plant.name,
        "plant": dict(case.plant.document),
        "mapping": _mapping(case.mapping),
        "episodes": [
            {
                "file": file.name,
                "role": str(e.role),
                "samples": len(e.t_s),
                "duration_s": float(e.t_s[-1]),
                "recording": e.conditions.get("recording", file.name),
            }
            for file, e in zip(case.files, case.episodes, strict=True)
        ],
        "findings": documents(case.findings),
        "is_role_declared": case.is_role_declared,
        "preview": _preview(case.plant, case.episodes[0]),
    }


def _mapping(mapping: SignalMapping) -> dict[str, Json]:
    return {**mapping.document(), "guesses": list(mapping.guesses)}


def _preview(plant: Plant, episode: Episode) -> dict[str, Json]:
    """A few samples of each channel of an episode, for a picture."""
    of = np.unique(np.linspace(0, len(episode.t_s) - 1, PREVIEW_SAMPLES).astype(int))
    channels = [
        *zip(plant.layout.observations, episode.observations.T, strict=True),
        *zip(plant.layout.commands, episode.commands.T, strict=True),
    ]
    return {
        "t_s": [float(t) for t in episode.t_s[of]],
        "channels": [
            {
                "name": channel.name,
                "unit": channel.unit,
                "values": [float(x) if np.isfinite(x) else None for x in values[of]],
            }
            for channel, values in channels
        ],
    }
