"""Run a consistency study: whether recordings agree on a version's numbers, each alone."""

from __future__ import annotations

from typing import Any

from trueup.canonical import Json
from trueup.diagnose.consistency import consistency, diagnosed
from trueup.diagnose.processes import in_processes
from trueup.episode.role import Role
from trueup_service.actions import find
from trueup_service.registry.records import JobRecord
from trueup_service.registry.transaction import reading
from trueup_service.wiring import Parts
from trueup_worker.inputs import read_episodes, read_plant, read_predictor
from trueup_worker.outputs import keep_report, leave_files, report_of
from trueup_worker.progress import Progress

READING = 0.2  # of the job's time

effects, result = leave_files, report_of


def compute(parts: Parts, job: JobRecord, progress: Progress) -> dict[str, Json]:
    """Fits every subset of the recordings. Repeating it gives the same bytes."""
    request: dict[str, Any] = job.request
    plant = read_plant(parts, job)
    (version,) = request["versions"]
    predictor = read_predictor(parts, job, version)
    roles = Role.ADAPTATION, Role.VALIDATION
    episodes = read_episodes(
        parts, job, plant, roles, progress.stage("reading episodes", 0.0, READING)
    )
    document = consistency(
        predictor,
        episodes,
        lambda stage, part: progress.stage(stage, READING, 1.0)(part),
        diagnoses=bool(request["diagnoses"]),
        solve=in_processes,
    )
    with reading(parts.database) as tx:
        model = find.artifact(tx, job.plant, version)
        earlier = [_row(find.job(tx, other)) for other in request["earlier"]]
    return keep_report(
        parts,
        {**document, "earlier": earlier, "model": f"v{model.version} {model.kind}"},
    )


def _row(job: JobRecord) -> dict[str, Json]:
    """An earlier diagnosis of the plant, as a row like those of the subsets."""
    result: Any = job.result
    return {
        "grouping": "diagnosis",
        "subset": f"of {job.created_at[:16].replace('T', ' ')}",
        "job": job.id,
        **diagnosed(result["report"]),
    }
