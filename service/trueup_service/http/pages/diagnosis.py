"""The page of a diagnosis: its progress while it runs, then its report."""

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
    """The progress of a diagnosis, why it failed, or its report."""
    record = _job(parts, plant, job)
    if record.state not in FINAL:
        return show(request, "running.html", job=record, study="diagnosis")
    if record.state != JobState.SUCCEEDED:
        return show(
            request,
            "failed.html",
            job=record,
            study="diagnosis",
            problem=(record.result or {}).get("problem"),
        )
    report, figures, command = _results(parts, record)
    values = view(
        report,
        figures,
        command and f"/v1/jobs/{job}/outputs/{COMMAND}",
        lambda digest: f"/plants/{plant}/episodes/{digest}",
    )
    return show(request, "diagnosis.html", job=record, **values)


@router.get("/plants/{plant}/diagnoses/{job}/report.html")
def report(parts: RequestParts, plant: PlantName, job: JobId) -> Response:
    """The report of a diagnosis as one file that needs no other."""
    record = _job(parts, plant, job)
    if record.state != JobState.SUCCEEDED:
        raise NotFound(
            f"diagnosis {job} has found nothing",
            noun="report",
            name=job,
            hint="Wait for it to succeed.",
        )
    document, figures, command = _results(parts, record)
    headers = {"Content-Disposition": f'attachment; filename="{plant}-{job[:12]}.html"'}
    return HTMLResponse(report_page(document, figures, command), headers=headers)


def _job(parts: Parts, plant: str, job: str) -> JobRecord:
    with reading(parts.database) as tx:
        record = find.job(tx, job)
    if record.plant != plant or record.kind != "diagnose":
        raise find.not_found("diagnosis", job)
    return record


def _results(
    parts: Parts, job: JobRecord
) -> tuple[dict[str, Any], dict[str, Any] | None, str | None]:
    """The report, the figures if they were stored, and the name of the command file if there is
    one."""
    with reading(parts.database) as tx:
        outputs = {o.name: o.digest for o in tx.outputs.of_job(job.id)}
    result: dict[str, Any] = job.result or {}
    figures = orjson.loads(parts.blobs.get(outputs[FIGURES])) if FIGURES in outputs else None
    return result["report"], figures, COMMAND if COMMAND in outputs else None
