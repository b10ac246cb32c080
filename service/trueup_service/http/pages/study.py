"""The pages of studies in open and in closed loop, of randomisations and of designed excitations:
their progress while they run, then their reports."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import orjson
from fastapi import Request, Response

from trueup_pages import closed_loop, consistency, excitation, open_loop, randomisation
from trueup_service.actions import find
from trueup_service.http.dependencies import PlantName, RequestContext, RequestParts
from trueup_service.http.pages.job_page import as_file, job_of, require_report, until_it_succeeds
from trueup_service.http.pages.page import begin_job, go, page_router, show
from trueup_service.http.routers.jobs import JobId
from trueup_service.http.schemas.jobs import (
    ClosedloopRequest,
    ConsistencyRequest,
    OpenloopRequest,
    RandomisationRequest,
)
from trueup_service.registry.records import JobRecord
from trueup_service.registry.transaction import reading
from trueup_service.wiring import Parts

router = page_router()
REPORT = "report.json"


@dataclass(frozen=True, slots=True)
class Study:
    """A kind of study: what it is called, its page's body, what makes the values of that, its
    report as one file, and the request that a button submits; None where a page of its own asks for
    more."""

    name: str
    body: str
    view: Callable[[Mapping[str, Any]], dict[str, Any]]
    report_page: Callable[[Mapping[str, Any]], str]
    request: OpenloopRequest | ClosedloopRequest | ConsistencyRequest | RandomisationRequest | None


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
    "consistency": Study(
        "consistency study",
        consistency.BODY,
        consistency.view,
        consistency.report_page,
        ConsistencyRequest(kind="consistency"),
    ),
    "randomise": Study(
        "randomisation",
        randomisation.BODY,
        randomisation.view,
        randomisation.report_page,
        RandomisationRequest(kind="randomise"),
    ),
    "excite": Study(
        "excitation",
        excitation.BODY,
        excitation.view,
        excitation.report_page,
        None,
    ),
}
Kind = Literal["openloop", "closedloop", "consistency", "randomise"]


@router.get("/plants/{plant}/studies/{job}")
def study(request: Request, parts: RequestParts, plant: PlantName, job: JobId) -> Response:
    """The progress of a study, why it failed, or its report."""
    record = job_of(parts, plant, job, STUDIES, "study")
    of = STUDIES[record.kind]
    if (page := until_it_succeeds(request, parts, record)) is not None:
        return page
    values = of.view(_report(parts, record))
    title = f"{of.name.capitalize()} of {plant}"
    return show(
        request, "study.html", job=record, study=of.name, title=title, body=of.body, **values
    )


@router.get("/plants/{plant}/studies/{job}/report.html")
def report(parts: RequestParts, plant: PlantName, job: JobId) -> Response:
    """The report of a study as one file that needs no other."""
    record = job_of(parts, plant, job, STUDIES, "study")
    require_report(record, "study")
    return as_file(record, STUDIES[record.kind].report_page(_report(parts, record)))


@router.post("/plants/{plant}/studies/{kind}")
def begin(parts: RequestParts, context: RequestContext, plant: PlantName, kind: Kind) -> Response:
    """Submit a study of the nominal model and what serves, and go to its page."""
    at_once = STUDIES[kind].request
    asked = at_once.model_dump(exclude={"kind"}, exclude_none=True) if at_once else {}
    job = begin_job(parts, context, plant, kind, asked)
    return go(f"/plants/{plant}/studies/{job}")


def _report(parts: Parts, job: JobRecord) -> dict[str, Any]:
    with reading(parts.database) as tx:
        output = find.output(tx, job.id, REPORT)
    document: dict[str, Any] = orjson.loads(parts.blobs.get(output.digest))
    return document
