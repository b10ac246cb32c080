"""Run versions in closed loop: how each tracks with a fixed planner, in every regime."""

from __future__ import annotations

from typing import Any

from trueup.canonical import Json
from trueup.control.courses import Courses, Travelled
from trueup.control.loop import LoopRun
from trueup.control.machine import machine_of
from trueup.control.regimes import Conditions, RegimeRuns, Runs, regimes_document
from trueup.episode.episode import Episode
from trueup.episode.role import Role
from trueup.model.plant import Plant
from trueup_service.registry.records import JobRecord
from trueup_service.wiring import Parts
from trueup_worker.exact_numbers import from_json, to_json
from trueup_worker.inputs import read_episodes, read_plant, read_versions
from trueup_worker.outputs import keep_report, leave_files, report_of
from trueup_worker.progress import Progress
from trueup_worker.spread import Spread

effects, result = leave_files, report_of


def compute(parts: Parts, job: JobRecord, progress: Progress) -> dict[str, Json]:
    """Runs every version in every regime; each pair is a part of the job. Repeating it gives the
    same bytes."""
    progress.stage("reading episodes", 0.0, 0.1)
    asked, artifacts = _read(parts, job)
    cases = [{"regime": regime, "model": name} for regime, name in asked.cases()]
    with Spread(parts.queue, job.id) as spread:
        answers = spread(cases, progress.stage("running", 0.1, 1.0))
        document = regimes_document(asked, map(_runs_from_json, answers))
    return keep_report(parts, {**document, "artifacts": artifacts})


def part(parts: Parts, job: JobRecord, asked: dict[str, Any]) -> Json:
    """Runs one version in one regime."""
    return _runs_to_json(_read(parts, job)[0].run((asked["regime"], asked["model"])))


def _read(parts: Parts, job: JobRecord) -> tuple[RegimeRuns, dict[str, Json]]:
    request: dict[str, Any] = job.request
    plant = read_plant(parts, job)
    models, (name, machine) = read_versions(parts, job)
    episodes = read_episodes(parts, job, plant, (Role.ADAPTATION,), lambda _: None)
    conditions = Conditions(
        tuple(request["regimes"]),
        tuple(request["seeds"]),
        request["delay_ticks"],
        request["authority"],
        tuple(request["sweep_ticks"]),
    )
    courses = _courses(plant, request, episodes)
    asked = RegimeRuns((name, machine_of(machine)), models.of, courses, conditions)
    return asked, models.artifacts


def _courses(plant: Plant, request: dict[str, Any], episodes: list[Episode]) -> Courses:
    """The declared reference, or waves as far as the episodes travelled."""
    ticks, effort = request["ticks"], request.get("effort")
    if declared := request.get("reference"):
        return Courses.declared(
            plant, declared["amplitude"], declared["frequency_hz"], ticks, effort
        )
    return Courses.within(plant, Travelled.of(plant, episodes), ticks, effort)


def _runs_to_json(runs: Runs) -> Json:
    first = runs.first
    return {
        "errors": to_json(runs.errors),
        "breaches": to_json(runs.breaches),
        "first": [to_json(x) for x in (first.states, first.issued, first.applied)],
    }


def _runs_from_json(document: Any) -> Runs:
    first = LoopRun(*(from_json(x) for x in document["first"]))
    return Runs(from_json(document["errors"]), from_json(document["breaches"]), first)
