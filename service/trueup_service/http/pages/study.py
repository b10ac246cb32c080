"""The pages of studies in open and in closed loop, and of randomisations: their progress while
they run, then their reports."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import orjson
from fastapi import Request, Response
from starlette.responses import HTMLResponse

from trueup_pages import closed_loop, open_loop, randomisation
from trueup_service.actions import find
from trueup_service.errors import NotFound
from trueup_service.http.dependencies import PlantName, RequestContext, RequestParts
from trueup_service.http.guard import guarded
from trueup_service.http.pages.page import begin_job, go, show
from trueup_service.http.routers.jobs import JobId
from trueup_service.http.schemas.jobs import (
    ClosedloopRequest,
    OpenloopRequest,
    RandomisationRequest,
)
from trueup_service.registry.records import FINAL, JobRecord, JobState
from trueup_service.registry.transaction import reading
from trueup_service.wiring import Parts

router = guarded("", ["pages"])
REPORT = "report.json"


@dataclass(frozen=True, slots=True)
class Study:
    """A kind of study: what it is called, its page's body, what makes the values of that, its
    report as one file, and the request that a page submits."""

    name: str
    body: str
    view: Callable[[Mapping[str, Any]], dict[str, Any]]
    report_page: Callable[[Mapping[str, Any]], str]
    request: OpenloopRequest | ClosedloopRequest | RandomisationRequest


STUDIES: Mapping[str, Study] = {
    "openloop": Study(
        "open loop",
        open_loop.BODY,
        open_loop.view,
        open_loop.report_page,
        OpenloopRequest(kind="openloop"),
    ),
    "closedloop": Study(
        "closed loop",
        closed_loop.BODY,
        closed_loop.view,
        closed_loop.report_page,
        ClosedloopRequest(kind="closedloop"),
    ),
    "randomise": Study(
        "randomisation",
        randomisation.BODY,
        randomisation.view,
        randomisation.report_page,
        RandomisationRequest(kind="randomise"),
    ),
}
Kind = Literal["openloop", "closedloop", "randomise"]


@router.get("/plants/{plant}/studies/{job}")
def study(request: Request, parts: RequestParts, plant: PlantName, job: JobId) -> Response:
    """The progress of a study, why it failed, or its report."""
    record = _job(parts, plant, job)
    of = STUDIES[record.kind]
    if record.state not in FINAL:
        return show(request, "running.html", job=record, study=of.name)
    if record.state != JobState.SUCCEEDED:
        problem = (record.result or {}).get("problem")
        return show(request, "failed.html", job=record, study=of.name, problem=problem)
    values = of.view(_report(parts, record))
    title = f"{of.name.capitalize()} of {plant}"
    return show(
        request, "study.html", job=record, study=of.name, title=title, body=of.body, **values
    )


@router.get("/plants/{plant}/studies/{job}/report.html")
def report(parts: RequestParts, plant: PlantName, job: JobId) -> Response:
    """The report of a study as one file that needs no other."""
    record = _job(parts, plant, job)
    if record.state != JobState.SUCCEEDED:
        raise NotFound(
            f"study {job} has found nothing",
            noun="report",
            name=job,
            hint="Wait for it to succeed.",
        )
    headers = {"Content-Disposition": f'attachment; filename="{plant}-{job[:12]}.html"'}
    page = STUDIES[record.kind].report_page(_report(parts, record))
    return HTMLResponse(page, headers=headers)


@router.post("/plants/{plant}/studies/{kind}")
def begin(parts: RequestParts, context: RequestContext, plant: PlantName, kind: Kind) -> Response:
    """Submit a study of the nominal model and what serves, and go to its page."""
    asked = STUDIES[kind].request.model_dump(exclude={"kind"}, exclude_none=True)
    job = begin_job(parts, context, plant, kind, asked)
    return go(f"/plants/{plant}/studies/{job}")


def _job(parts: Parts, plant: str, job: str) -> JobRecord:
    with reading(parts.database) as tx:
        record = find.job(tx, job)
    if record.plant != plant or record.kind not in STUDIES:
        raise find.not_found("study", job)
    return record


def _report(parts: Parts, job: JobRecord) -> dict[str, Any]:
    with reading(parts.database) as tx:
        output = find.output(tx, job.id, REPORT)
    document: dict[str, Any] = orjson.loads(parts.blobs.get(output.digest))
    return document
