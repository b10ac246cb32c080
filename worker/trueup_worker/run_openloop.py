"""Run an open loop: versions' errors after some numbers of steps, beside the bound on them."""

from __future__ import annotations

from typing import Any

from trueup.canonical import Json
from trueup.diagnose.open_loop import open_loop
from trueup.episode.role import Role
from trueup_service.registry.records import JobRecord
from trueup_service.wiring import Parts
from trueup_worker.inputs import read_episodes, read_plant, read_versions
from trueup_worker.outputs import keep_report, leave_files, report_of
from trueup_worker.progress import Progress

effects, result = leave_files, report_of


def compute(parts: Parts, job: JobRecord, progress: Progress) -> dict[str, Json]:
    """Rolls every version out. Repeating it gives the same bytes."""
    request: dict[str, Any] = job.request
    plant = read_plant(parts, job)
    models, machine = read_versions(parts, job)
    episodes = read_episodes(
        parts, job, plant, tuple(Role), progress.stage("reading episodes", 0.0, 0.3)
    )
    rolling = progress.stage("rolling out", 0.3, 1.0)
    document = open_loop(models.of, machine, episodes, request["horizons_steps"], rolling)
    return keep_report(parts, {**document, "artifacts": models.artifacts})
