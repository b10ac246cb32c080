"""Run versions in closed loop: how each tracks with a fixed planner, in every regime."""

from __future__ import annotations

from typing import Any

from trueup.canonical import Json
from trueup.control.courses import Courses, Travelled
from trueup.control.machine import machine_of
from trueup.control.regimes import Conditions, run_regimes
from trueup.episode.episode import Episode
from trueup.episode.role import Role
from trueup.model.plant import Plant
from trueup_service.registry.records import JobRecord
from trueup_service.wiring import Parts
from trueup_worker.inputs import read_episodes, read_plant, read_versions
from trueup_worker.outputs import keep_report, leave_files, report_of
from trueup_worker.progress import Progress

effects, result = leave_files, report_of


def compute(parts: Parts, job: JobRecord, progress: Progress) -> dict[str, Json]:
    """Runs every version in every regime. Repeating it gives the same bytes."""
    request: dict[str, Any] = job.request
    plant = read_plant(parts, job)
    models, (name, machine) = read_versions(parts, job)
    episodes = read_episodes(
        parts, job, plant, (Role.ADAPTATION,), progress.stage("reading episodes", 0.0, 0.1)
    )
    conditions = Conditions(
        tuple(request["regimes"]),
        tuple(request["seeds"]),
        request["delay_ticks"],
        request["authority"],
        tuple(request["sweep_ticks"]),
    )
    document = run_regimes(
        (name, machine_of(machine)),
        models.of,
        _courses(plant, request, episodes),
        conditions,
        progress.stage("running", 0.1, 1.0),
    )
    return keep_report(parts, {**document, "artifacts": models.artifacts})


def _courses(plant: Plant, request: dict[str, Any], episodes: list[Episode]) -> Courses:
    """The declared reference, or waves as far as the episodes travelled."""
    ticks, effort = request["ticks"], request.get("effort")
    if declared := request.get("reference"):
        return Courses.declared(
            plant, declared["amplitude"], declared["frequency_hz"], ticks, effort
        )
    return Courses.within(plant, Travelled.of(plant, episodes), ticks, effort)
