"""The pages of jobs: what is under way and behind what it waits, each job's progress, and the forms
that submit one."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

from fastapi import Query, Request, Response
from pydantic import TypeAdapter
from starlette.concurrency import run_in_threadpool

from trueup_pages.blindtrial import view as blindtrial_view
from trueup_pages.jobs import NAMES, name_of
from trueup_service.actions import find
from trueup_service.actions.cancel_job import cancel_job
from trueup_service.actor_context import END_OF_TIME
from trueup_service.http.dependencies import PlantName, RequestContext, RequestParts
from trueup_service.http.guard import CurrentPrincipal
from trueup_service.http.pages.job_page import job_of, queue_of, until_it_succeeds
from trueup_service.http.pages.page import HEADERS, begin_job, checked, form, go, page_router, show
from trueup_service.http.pages.study import STUDIES
from trueup_service.http.routers.jobs import JobId, JobRequest
from trueup_service.registry.records import FINAL, JobRecord
from trueup_service.registry.transaction import ReadTransaction, reading, writing

router = page_router()
LISTED = 50
REQUEST: TypeAdapter[Any] = TypeAdapter(JobRequest)
LISTS = ("features", "detectors", "versions", "episodes")  # fields that a form separates by commas


@router.get("/jobs")
def jobs(request: Request, parts: RequestParts, principal: CurrentPrincipal) -> Response:
    """What is under way, of all plants that the token sees."""
    queue = queue_of(parts, principal)
    return show(request, "jobs.html", plant=None, queue=queue, names=name_of)


@router.get("/plants/{plant}/jobs")
def jobs_of_plant(
    request: Request,
    parts: RequestParts,
    principal: CurrentPrincipal,
    plant: PlantName,
    before: Annotated[str, Query(max_length=27)] = END_OF_TIME,
) -> Response:
    """What is under way of a plant, and what has ended, the newest first."""
    with reading(parts.database) as tx:
        find.plant_digest(tx, plant)
        page = tx.jobs.page(plant, before, LISTED + 1)
    queue = [(q, standing) for q, standing in queue_of(parts, principal) if q.job.plant == plant]
    return show(
        request,
        "jobs.html",
        plant=plant,
        queue=queue,
        ended=[j for j in page[:LISTED] if j.state in FINAL],
        more=page[LISTED - 1].created_at if len(page) > LISTED else None,
        names=name_of,
    )


@router.get("/plants/{plant}/jobs/{job}")
def job(request: Request, parts: RequestParts, plant: PlantName, job: JobId) -> Response:
    """The progress of a job, why it failed, or the page of what it made."""
    record = job_of(parts, plant, job, NAMES, "job")
    if (page := until_it_succeeds(request, parts, record)) is not None:
        return page
    if record.kind == "blindtrial":
        result: dict[str, Any] = record.result or {}
        values = blindtrial_view(result["report"])
        return show(request, "blindtrial_page.html", job=record, **values)
    with reading(parts.database) as tx:
        to = _page_of_result(tx, record)
    if request.headers.get("hx-request"):  # the page that waited goes there as a whole
        return Response(headers={**HEADERS, "HX-Redirect": to})
    return go(to)


def _page_of_result(tx: ReadTransaction, job: JobRecord) -> str:
    """The page that shows what a job made."""
    here, result = f"/plants/{job.plant}", job.result or {}
    if job.kind == "diagnose":
        return f"{here}/diagnoses/{job.id}"
    if job.kind in STUDIES:
        return f"{here}/studies/{job.id}"
    if job.kind in ("gate", "recompute"):
        return f"{here}/decisions/{result['decision']}"
    if job.kind == "compare":
        first, second = (
            find.artifact(tx, job.plant, str(job.request[which])).version
            for which in ("first", "second")
        )
        return f"{here}/compare?first={first}&second={second}"
    if job.kind in ("calibrate", "watch", "validate"):
        return f"{here}/monitor"
    return f"{here}#versions"


@router.post("/plants/{plant}/jobs")
async def submit(
    request: Request, parts: RequestParts, context: RequestContext, plant: PlantName
) -> Response:
    """Submit the job that a form describes, and go to its page."""
    asked = _asked(await form(request))
    job = await run_in_threadpool(begin_job, parts, context, plant, asked.pop("kind"), asked)
    return go(f"/plants/{plant}/jobs/{job}")


@router.post("/plants/{plant}/jobs/{job}/cancel")
def cancel(parts: RequestParts, context: RequestContext, plant: PlantName, job: JobId) -> Response:
    """Cancel a job, and go back to the plant's jobs."""
    job_of(parts, plant, job, NAMES, "job")
    with writing(parts.database) as tx:
        cancel_job(tx, job, context)
    return go(f"/plants/{plant}/jobs")


def _asked(fields: Mapping[str, str]) -> dict[str, Any]:
    """The request for a job in a form's fields; an empty one is left to its default. Raises
    BadRequest."""
    given: dict[str, Any] = {
        name: [part.strip() for part in value.split(",")] if name in LISTS else value
        for name, value in fields.items()
        if value.strip()
    }
    asked: dict[str, Any] = checked(REQUEST.validate_python, given).model_dump(exclude_none=True)
    return asked
