"""Routes of jobs, which workers run, with progress and cancellation."""

from __future__ import annotations

import uuid
from datetime import UTC, datetime
from typing import Annotated

from fastapi import Body, Path, Response
from starlette.responses import StreamingResponse

from trueup_service.actions import find
from trueup_service.actions.cancel_job import cancel_job
from trueup_service.actions.submission import Submission
from trueup_service.actions.submit_job import SUBMIT
from trueup_service.actor_context import END_OF_TIME
from trueup_service.http.dependencies import (
    BeforeTime,
    IdempotencyKey,
    Limit,
    PlantName,
    RequestContext,
    RequestParts,
    create,
)
from trueup_service.http.downloads import send_blob
from trueup_service.http.guard import CurrentPrincipal, guarded, is_visible, require_visible
from trueup_service.http.openapi import already_exists
from trueup_service.http.schemas.jobs import (
    BlindtrialRequest,
    CalibrationRequest,
    ClosedloopRequest,
    ComparisonRequest,
    ConsistencyRequest,
    DiagnosisRequest,
    ExcitationRequest,
    FitRequest,
    GateRequest,
    Job,
    JobWithReads,
    OpenloopRequest,
    Output,
    QueuedJob,
    RandomisationRequest,
    RecomputationRequest,
    ValidationRequest,
)
from trueup_service.http.schemas.wire import Page, page
from trueup_service.registry.job_queue import queued_jobs
from trueup_service.registry.transaction import reading, writing

router = guarded("/v1", ["jobs"])
JobId = Annotated[str, Path(pattern=r"^[0-9a-f]{32}$")]
OutputName = Annotated[str, Path(pattern=r"^[a-z0-9_.-]{1,63}$", description="The file's name")]
JobRequest = Annotated[
    FitRequest
    | GateRequest
    | DiagnosisRequest
    | BlindtrialRequest
    | CalibrationRequest
    | ValidationRequest
    | RecomputationRequest
    | ComparisonRequest
    | OpenloopRequest
    | ClosedloopRequest
    | ConsistencyRequest
    | RandomisationRequest
    | ExcitationRequest,
    Body(discriminator="kind"),
]


@router.post(
    "/plants/{plant}/jobs",
    status_code=201,
    response_model=Job,
    summary="Submit a fit, a trial, a diagnosis, a study or a calibration",
    responses=already_exists(Job),
)
def submit(
    parts: RequestParts,
    context: RequestContext,
    plant: PlantName,
    request: JobRequest,
    key: IdempotencyKey = None,
) -> Response:
    """Everything that the job will read is frozen now. A fit reads adaptation episodes only, and a
    trial held-out ones only. A diagnosis fits adaptation episodes and compares on held-out ones. A
    calibration makes a monitor of what serves, on healthy episodes."""
    chosen, job = request.model_dump(exclude={"kind"}, exclude_none=True), uuid.uuid4().hex
    act = SUBMIT[request.kind]
    parts.queue.prepare()
    frozen = {"kind": request.kind, **chosen}
    return create(
        parts,
        context,
        f"jobs/{plant}",
        key,
        frozen,
        lambda w: (act(Submission(w, parts.queue, job, plant, chosen, context)), True),
        Job,
    )


@router.get("/plants/{plant}/jobs", summary="List jobs, the newest first")
def list_jobs(
    parts: RequestParts, plant: PlantName, before: BeforeTime = END_OF_TIME, limit: Limit = 100
) -> Page[Job]:
    with reading(parts.database) as tx:
        find.plant_digest(tx, plant)
        jobs = tx.jobs.page(plant, before, limit)
    return page(Job, jobs, limit, "created_at")


@router.get("/jobs", summary="List the jobs that have not ended, the oldest first")
def list_queue(parts: RequestParts, principal: CurrentPrincipal) -> Page[QueuedJob]:
    """Of all plants that the token sees. `ahead` counts those of other plants, too."""
    with reading(parts.database) as tx:
        queue = queued_jobs(tx, datetime.now(UTC))
    seen = [q for q in queue if is_visible(parts.database, principal, q.job.plant)]
    return Page(
        items=[
            QueuedJob(
                **Job.model_validate(q.job).model_dump(exclude={"operation"}),
                worker=q.worker,
                begun_at=q.begun_at,
                ahead=len(q.ahead),
                waits_s=q.waits_s,
                takes_s=q.takes_s,
            )
            for q in seen
        ]
    )


@router.get("/jobs/{job}", summary="Get a job with its progress and what it has read")
def get_job(parts: RequestParts, principal: CurrentPrincipal, job: JobId) -> JobWithReads:
    with reading(parts.database) as tx:
        record = find.job(tx, job)
        require_visible(parts.database, principal, record.plant, find.not_found("job", job))
        outputs = [Output.model_validate(o) for o in tx.outputs.of_job(job)]
        return JobWithReads(
            **Job.model_validate(record).model_dump(), reads=tx.jobs.reads(job), outputs=outputs
        )


@router.get(
    "/jobs/{job}/outputs/{name}",
    summary="Download a file that a job left behind",
    response_class=Response,
)
def get_output(
    parts: RequestParts, principal: CurrentPrincipal, job: JobId, name: OutputName
) -> StreamingResponse:
    """A diagnosis leaves `figures.json`, the numbers behind its pictures, and `next_experiment.csv`
    where it proposes one. A study in open or closed loop leaves `report.json`."""
    with reading(parts.database) as tx:
        require_visible(
            parts.database, principal, find.job(tx, job).plant, find.not_found("job", job)
        )
        output = find.output(tx, job, name)
    named = f'attachment; filename="{output.name}"'
    return send_blob(
        parts.blobs, output.digest, output.size_bytes, output.media_type, Content_Disposition=named
    )


@router.post("/jobs/{job}/cancel", summary="Cancel a job")
def cancel(
    parts: RequestParts, context: RequestContext, principal: CurrentPrincipal, job: JobId
) -> Job:
    """A waiting job is cancelled at once, and a running one at its next report of progress. A
    finished job stays as it is."""
    with reading(parts.database) as tx:
        require_visible(
            parts.database, principal, find.job(tx, job).plant, find.not_found("job", job)
        )
    with writing(parts.database) as tx:
        return Job.model_validate(cancel_job(tx, job, context))
