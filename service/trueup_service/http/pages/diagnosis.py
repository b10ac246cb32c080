"""A diagnosis: while it runs how far it is, then what it found."""

from __future__ import annotations

from typing import Any

import orjson
from fastapi import Request, Response
from starlette.responses import HTMLResponse

from trueup_pages.diagnosis import report_page, view
from trueup_service.actions import find
from trueup_service.errors import NotFound
from trueup_service.http.dependencies import PlantName, RequestParts
from trueup_service.http.guard import guarded
from trueup_service.http.pages.page import show
from trueup_service.http.routers.jobs import JobId
from trueup_service.registry.records import FINAL, JobRecord, JobState
from trueup_service.registry.transaction import reading
from trueup_service.wiring import Parts

router = guarded("", ["pages"])
FIGURES, COMMAND = "figures.json", "next_experiment.csv"


@router.get("/plants/{plant}/diagnoses/{job}")
def diagnosis(request: Request, parts: RequestParts, plant: PlantName, job: JobId) -> Response:
    """How far it is, why it failed, or what it found."""
    found = _job(parts, plant, job)
    if found.state not in FINAL:
        return show(request, "running.html", job=found)
    if found.state != JobState.SUCCEEDED:
        return show(request, "failed.html", job=found, problem=(found.result or {}).get("problem"))
    report, figures, command = _found(parts, found)
    values = view(
        report,
        figures,
        command and f"/v1/jobs/{job}/outputs/{COMMAND}",
        lambda digest: f"/plants/{plant}/episodes/{digest}",
    )
    return show(request, "diagnosis.html", job=found, **values)


@router.get("/plants/{plant}/diagnoses/{job}/report.html")
def report(parts: RequestParts, plant: PlantName, job: JobId) -> Response:
    """The same as one file that needs nothing else."""
    found = _job(parts, plant, job)
    if found.state != JobState.SUCCEEDED:
        raise NotFound(
            f"diagnosis {job} has found nothing",
            noun="report",
            name=job,
            hint="Wait for it to succeed.",
        )
    document, figures, command = _found(parts, found)
    headers = {"Content-Disposition": f'attachment; filename="{plant}-{job[:12]}.html"'}
    return HTMLResponse(report_page(document, figures, command), headers=headers)


def _job(parts: Parts, plant: str, job: str) -> JobRecord:
    with reading(parts.database) as tx:
        found = find.job(tx, job)
    if found.plant != plant or found.kind != "diagnose":
        raise find.not_found("diagnosis", job)
    return found


def _found(
    parts: Parts, job: JobRecord
) -> tuple[dict[str, Any], dict[str, Any] | None, str | None]:
    """The report, the figures if they were kept, and the name of the command's file if there is
    one."""
    with reading(parts.database) as tx:
        outputs = {o.name: o.digest for o in tx.outputs.of_job(job.id)}
    result: dict[str, Any] = job.result or {}
    figures = orjson.loads(parts.blobs.get(outputs[FIGURES])) if FIGURES in outputs else None
    return result["report"], figures, COMMAND if COMMAND in outputs else None
