"""Recovery: jobs of dead workers are resumed, and jobs that the engine gave up on are retried.

A worker cut off from its database may still be computing. Its effects are refused, because a job is
finished once.
"""

from __future__ import annotations

import logging
import os
import threading
import time
from datetime import UTC, datetime

from sqlalchemy.exc import IntegrityError

from trueup.canonical import Json
from trueup_service.actions.finish_job import finish_job
from trueup_service.actor_context import ActorContext, time_text
from trueup_service.engine import DBOS, SetWorkflowID
from trueup_service.jobs import ENGINE_VERSION, QUEUE, alone_with, queue_of
from trueup_service.registry.database import Database
from trueup_service.registry.records import FINAL, JobRecord, JobState
from trueup_service.registry.transaction import reading, writing
from trueup_worker.liveness import Liveness
from trueup_worker.sleeping import has_work

log = logging.getLogger("trueup.worker")

ATTEMPT_SEPARATOR = "-"  # between a job's id and the number of an attempt after its first
LINGER_S = 10.0  # without any job, until the engine is ended
ATTEMPTS = 5  # each of which the engine tried for a minute


def resume_orphaned(liveness: Liveness, own: str) -> list[str]:
    """Puts the jobs that dead workers had begun back into the queue, and returns their ids."""
    pending = DBOS.list_workflows(status="PENDING", load_input=False, load_output=False)
    resumed = []
    for name in sorted({w.executor_id for w in pending if w.executor_id and w.executor_id != own}):
        with liveness.try_acquire(name) as is_dead:
            if is_dead:
                resumed += [
                    _resume(w.workflow_id, w.queue_name or QUEUE, name)
                    for w in DBOS.list_workflows(
                        status="PENDING", executor_id=name, load_input=False, load_output=False
                    )
                ]
    return resumed


def _resume(job: str, queue: str, dead: str) -> str:
    DBOS.resume_workflow(job, queue_name=queue)
    log.warning("taken over", extra={"job": job, "dead_worker": dead})
    return job


def retry_given_up(database: Database) -> list[str]:
    """Retries the jobs that the engine gave up on, from the failed step, and returns their ids.

    Such is a job that could not be closed while the database was away. A job that was given up on
    ATTEMPTS times fails.
    """
    given_up = DBOS.list_workflows(status="ERROR", load_input=False, load_output=False)
    retried = []
    for job_id in sorted({w.workflow_id.split(ATTEMPT_SEPARATOR)[0] for w in given_up}):
        with reading(database) as tx:
            job = tx.jobs.get(job_id)
        if job is None or job.state in FINAL:
            continue
        attempts = DBOS.list_workflows(
            workflow_id_prefix=job_id, load_input=False, load_output=False
        )
        if any(a.status != "ERROR" for a in attempts):
            continue
        if len(attempts) >= ATTEMPTS:
            _fail(database, job)
        else:
            last = max(
                attempts, key=lambda a: (a.created_at or 0, len(a.workflow_id), a.workflow_id)
            )
            try:
                _retry(job, last.workflow_id, len(attempts))
            except IntegrityError:
                continue  # another worker was quicker
            retried.append(job_id)
    return retried


def _retry(job: JobRecord, last: str, attempts: int) -> None:
    """Starts one more attempt, under a name that only one worker can take."""
    steps = DBOS.list_workflow_steps(last)
    failed = next((s["function_id"] for s in steps if s["error"] is not None), len(steps) + 1)
    with SetWorkflowID(f"{job.id}{ATTEMPT_SEPARATOR}{attempts}"):
        DBOS.fork_workflow(
            last,
            failed,
            application_version=ENGINE_VERSION,
            queue_name=queue_of(job.kind),
            queue_partition_key=alone_with(job.kind, job.plant),
        )
    log.warning("begun again", extra={"job": job.id, "attempt": attempts + 1})


def _fail(database: Database, job: JobRecord) -> None:
    problem: dict[str, Json] = {
        "code": "given-up",
        "detail": f"the job engine gave up {ATTEMPTS} times",
        "hint": "Read the worker's log, then submit the job again.",
    }
    context = ActorContext(job.created_by, time_text(datetime.now(UTC)))
    with writing(database) as tx:
        finish_job(tx, job, JobState.FAILED, {"problem": problem}, context)
    log.error("given up", extra={"job": job.id})


def recover(
    database: Database, liveness: Liveness, own: str, interval_s: float, stop: threading.Event
) -> None:
    """Resumes and retries jobs every `interval_s` [s], until `stop` is set or no job has been under
    way for LINGER_S."""
    idle_since = time.monotonic()
    while not stop.wait(interval_s):
        try:
            require_held(liveness)
            if has_work(database):
                idle_since = time.monotonic()
                resume_orphaned(liveness, own)
                retry_given_up(database)
            elif time.monotonic() - idle_since > LINGER_S:
                return
        except Exception:
            log.exception("looking for dead workers failed; looking again")


def require_held(liveness: Liveness) -> None:
    """Ends the process if the lock that shows this worker alive is lost."""
    if not liveness.is_held():
        log.error("the session that shows this worker alive is gone; stopping")
        os._exit(75)  # EX_TEMPFAIL: another worker may already be running our job
