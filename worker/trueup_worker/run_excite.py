"""Run the design of an excitation: a bounded command that identifies a plant's numbers, or
separates the explanations that a diagnosis left."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from trueup.canonical import Json
from trueup.diagnose.excitation_design import SPREAD, Allowed, design
from trueup.diagnose.excitation_files import MEDIA_TYPES, excitation_files, excitation_report
from trueup.episode.role import Role
from trueup.errors import NotIdentifiable
from trueup.model.corrected import Corrected
from trueup_service.actions import find
from trueup_service.registry.records import JobRecord
from trueup_service.registry.transaction import reading
from trueup_service.wiring import Parts
from trueup_worker.inputs import read_episodes, read_plant, read_predictor
from trueup_worker.outputs import keep_file, keep_report, leave_files, report_of
from trueup_worker.progress import Progress

READING = 0.1  # of the job's time

effects, result = leave_files, report_of


def compute(parts: Parts, job: JobRecord, progress: Progress) -> dict[str, Json]:
    """Designs the excitation. Repeating it gives the same bytes."""
    request: dict[str, Any] = job.request
    plant = read_plant(parts, job)
    episodes = read_episodes(
        parts, job, plant, (Role.ADAPTATION,), progress.stage("reading episodes", 0.0, READING)
    )
    band = request.get("band_hz")
    allowed = Allowed(
        request["duration_s"],
        None if band is None else (band[0], band[1]),
        request.get("rate"),
        request.get("speed"),
        request["margin"],
    )
    designed = design(
        plant,
        episodes,
        allowed,
        diagnosed=_diagnosed(parts, job),
        spread=request.get("spread", SPREAD),
        split=request["goal"] == "split",
        seed=request["seed"],
        progress=lambda stage, part: progress.stage(stage, READING, 1.0)(part),
    )
    outcome = keep_report(
        parts, {**excitation_report(designed), "diagnosis": request.get("diagnosis")}
    )
    played: Any = [
        keep_file(parts, name, MEDIA_TYPES[name], content)
        for name, content in excitation_files(designed).items()
    ]
    files: Any = outcome["files"]
    return {**outcome, "files": [*files, *played]}


def _diagnosed(parts: Parts, job: JobRecord) -> tuple[Corrected, Mapping[str, Any]] | None:
    """The model of the request's diagnosis, and its report; None where it names none. Raises
    NotIdentifiable where that model has no uncertainty to design by."""
    named = job.request.get("diagnosis")
    if named is None:
        return None
    with reading(parts.database) as tx:
        diagnosis: Any = find.job(tx, str(named)).result
    model = read_predictor(parts, job, diagnosis["artifact"])
    if not isinstance(model, Corrected):
        raise NotIdentifiable(
            "the diagnosis left no corrected model to sharpen",
            hint="Give `spread`, the relative 95 % interval of each declared number, instead.",
        )
    return model, diagnosis["report"]
