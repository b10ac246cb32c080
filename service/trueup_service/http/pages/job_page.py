"""What the pages of jobs share: which job is shown, what is shown until it has succeeded, and its
report as a file."""

from __future__ import annotations

from collections.abc import Container
from datetime import UTC, datetime

from fastapi import Request, Response
from starlette.responses import HTMLResponse

from trueup_pages import jobs as words
from trueup_service.actions import find
from trueup_service.authentication import Principal
from trueup_service.errors import NotFound
from trueup_service.http.guard import is_visible
from trueup_service.http.pages.page import show
from trueup_service.registry.job_queue import QueuedJob, queued_jobs
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


def queue_of(parts: Parts, principal: Principal) -> list[tuple[QueuedJob, str]]:
    """The jobs that have not ended and that somebody sees, the oldest first, with where each
    stands in words."""
    now = datetime.now(UTC)
    with reading(parts.database) as tx:
        queue = queued_jobs(tx, now)
    plants = {queued.job.plant for queued in queue}
    seen = {plant for plant in plants if is_visible(parts.database, principal, plant)}
    return [(queued, _standing(queued, seen, now)) for queued in queue if queued.job.plant in seen]


def _standing(queued: QueuedJob, seen: Container[str], now: datetime) -> str:
    waited_s = (now - datetime.fromisoformat(queued.job.created_at)).total_seconds()
    return words.standing(queued, [job for job in queued.ahead if job.plant in seen], waited_s)


def until_it_succeeds(request: Request, parts: Parts, job: JobRecord) -> Response | None:
    """The page of a job's progress, or of why it failed; None where it has succeeded."""
    name = words.name_of(job.kind)
    if job.state not in FINAL:
        standing = next(
            (s for q, s in queue_of(parts, request.scope["principal"]) if q.job.id == job.id), ""
        )
        return show(request, "running.html", job=job, name=name, standing=standing)
    if job.state != JobState.SUCCEEDED:
        problem = (job.result or {}).get("problem")
        return show(request, "failed.html", job=job, name=name, problem=problem)
    return None


def require_report(job: JobRecord, noun: str) -> None:
    """Raises NotFound where a job has no report, since it has not succeeded."""
    if job.state != JobState.SUCCEEDED:
        raise NotFound(
            f"{noun} {job.id} has no report",
            noun="report",
            name=job.id,
            hint="Wait for it to succeed.",
        )


def as_file(job: JobRecord, page: str) -> Response:
    """A report as one file that needs no other, named after the plant and the job."""
    headers = {"Content-Disposition": f'attachment; filename="{job.plant}-{job.id[:12]}.html"'}
    return HTMLResponse(page, headers=headers)
