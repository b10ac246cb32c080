"""What the pages of jobs share: which job is shown, what is shown until it has succeeded, and its
report as a file."""

from __future__ import annotations

from collections.abc import Container

from fastapi import Request, Response
from starlette.responses import HTMLResponse

from trueup_service.actions import find
from trueup_service.errors import NotFound
from trueup_service.http.pages.page import show
from trueup_service.registry.records import FINAL, JobRecord, JobState
from trueup_service.registry.transaction import reading
from trueup_service.wiring import Parts


def job_of(parts: Parts, plant: str, job: str, kinds: Container[str], noun: str) -> JobRecord:
    """A job of a plant that is of one of these kinds. Raises NotFound, by this noun."""
    with reading(parts.database) as tx:
        record = find.job(tx, job)
    if record.plant != plant or record.kind not in kinds:
        raise find.not_found(noun, job)
    return record


def until_it_succeeds(request: Request, job: JobRecord, name: str) -> Response | None:
    """The page of a job's progress, or of why it failed; None where it has succeeded."""
    if job.state not in FINAL:
        return show(request, "running.html", job=job, study=name)
    if job.state != JobState.SUCCEEDED:
        problem = (job.result or {}).get("problem")
        return show(request, "failed.html", job=job, study=name, problem=problem)
    return None


def require_report(job: JobRecord, noun: str) -> None:
    """Raises NotFound where a job has no report, since it has not succeeded."""
    if job.state != JobState.SUCCEEDED:
        raise NotFound(
            f"{noun} {job.id} has found nothing",
            noun="report",
            name=job.id,
            hint="Wait for it to succeed.",
        )


def as_file(job: JobRecord, page: str) -> Response:
    """A report as one file that needs no other, named after the plant and the job."""
    headers = {"Content-Disposition": f'attachment; filename="{job.plant}-{job.id[:12]}.html"'}
    return HTMLResponse(page, headers=headers)
