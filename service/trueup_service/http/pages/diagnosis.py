"""The page of a diagnosis: its progress while it runs, then its report."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import orjson
from fastapi import Request, Response

from trueup_pages.diagnosis import report_page, view
from trueup_service.actions import find
from trueup_service.http.dependencies import PlantName, RequestParts
from trueup_service.http.pages.job_page import as_file, job_of, require_report, until_it_succeeds
from trueup_service.http.pages.next_step import step_after
from trueup_service.http.pages.page import page_router, show
from trueup_service.http.routers.jobs import JobId
from trueup_service.registry.records import JobRecord
from trueup_service.registry.transaction import reading
from trueup_service.wiring import Parts

router = page_router()
FIGURES, COMMAND = "figures.json", "next_experiment.csv"


@router.get("/plants/{plant}/diagnoses/{job}")
def diagnosis(request: Request, parts: RequestParts, plant: PlantName, job: JobId) -> Response:
    """The progress of a diagnosis, why it failed, or its report."""
    record = job_of(parts, plant, job, ["diagnose"], "diagnosis")
    if (page := until_it_succeeds(request, parts, record)) is not None:
        return page
    report, figures, command = _results(parts, record)
    with reading(parts.database) as tx:
        step = step_after(tx, plant, find.serving(tx, plant), record)
    values = view(
        report,
        figures,
        command and f"/v1/jobs/{job}/outputs/{COMMAND}",
        lambda digest: f"/plants/{plant}/episodes/{digest}",
        step,
        _names(parts, plant, report),
    )
    return show(request, "diagnosis.html", job=record, **values)


@router.get("/plants/{plant}/diagnoses/{job}/report.html")
def report(parts: RequestParts, plant: PlantName, job: JobId) -> Response:
    """The report of a diagnosis as one file that needs no other."""
    record = job_of(parts, plant, job, ["diagnose"], "diagnosis")
    require_report(record, "diagnosis")
    document, figures, command = _results(parts, record)
    return as_file(record, report_page(document, figures, command, _names(parts, plant, document)))


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


def _names(parts: Parts, plant: str, report: Mapping[str, Any]) -> dict[str, str]:
    """What the recordings of a report are called, by digest."""
    with reading(parts.database) as tx:
        return find.names_of_episodes(
            tx, plant, [e["sha256"] for e in report["evidence"]["episodes"]]
        )
