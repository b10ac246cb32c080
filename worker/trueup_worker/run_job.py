"""Run one job in two steps that may each be repeated: compute, then finish. Both run in a compute
process, and so do parts of a job.

Computing writes blobs only, which are named by their content. Finishing is one transaction, which
happens only if the job is not finished yet. So a job has its effects once, however often its worker
was killed.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from datetime import UTC, datetime
from types import ModuleType
from typing import Any

from sqlalchemy.exc import DataError, SQLAlchemyError

from trueup.canonical import Json
from trueup.errors import TrueupError
from trueup_service.actions import find
from trueup_service.actions.finish_job import finish_job
from trueup_service.actor_context import ActorContext, time_text
from trueup_service.registry.attempts import AttemptRecord
from trueup_service.registry.records import FINAL, JobRecord, JobState
from trueup_service.registry.transaction import reading, writing
from trueup_service.wiring import Parts
from trueup_worker import (
    run_blindtrial,
    run_calibration,
    run_closedloop,
    run_compare,
    run_consistency,
    run_diagnosis,
    run_excite,
    run_fit,
    run_gate,
    run_openloop,
    run_randomise,
    run_recompute,
    run_validation,
    run_watch,
)
from trueup_worker.job_problems import MemoryLimit, ProcessDied, problem_of
from trueup_worker.progress import Cancelled, Progress

log = logging.getLogger("trueup.worker")

KINDS: dict[str, ModuleType] = {
    "fit": run_fit,
    "gate": run_gate,
    "diagnose": run_diagnosis,
    "blindtrial": run_blindtrial,
    "calibrate": run_calibration,
    "watch": run_watch,
    "validate": run_validation,
    "recompute": run_recompute,
    "compare": run_compare,
    "openloop": run_openloop,
    "closedloop": run_closedloop,
    "consistency": run_consistency,
    "randomise": run_randomise,
    "excite": run_excite,
}


def compute(parts: Parts, job_id: str, worker: str) -> dict[str, Json]:
    """Computes a job, and returns its final state with the outcome or the problem, as JSON."""
    with writing(parts.database) as tx:
        job = find.job(tx, job_id)
        if job.state in FINAL:
            return {"state": job.state}
        deaths = tx.attempts.begin(job_id, worker, _now())
        if job.state == JobState.QUEUED:
            tx.jobs.update(job_id, now=_now(), state=JobState.RUNNING, stage="starting")
    try:
        if job.state == JobState.CANCELLING:
            raise Cancelled
        _require_attempts_left(parts, job, deaths)
        with Progress(parts, job) as progress:
            outcome = KINDS[job.kind].compute(parts, job, progress)
        return {"state": JobState.SUCCEEDED.value, "outcome": outcome}
    except SQLAlchemyError:
        raise  # the database, not the job: the engine tries this step again
    except Cancelled as error:
        return {"state": JobState.CANCELLED.value, "problem": problem_of(error)}
    except Exception as error:  # noqa: BLE001  (the job must end)
        return {"state": JobState.FAILED.value, "problem": _problem_of_any(error, job_id)}


def part(parts: Parts, entry: str, job_id: str, asked: Json, worker: str) -> dict[str, Json]:
    """Computes a part of a job, and returns its answer or its problem, as JSON."""
    with writing(parts.database) as tx:
        job = find.job(tx, job_id)
        deaths = tx.attempts.begin(entry, worker, _now())
    try:
        if job.state not in (JobState.RUNNING, JobState.QUEUED):
            raise Cancelled
        _require_attempts_left(parts, job, deaths)
        answer = {"answer": KINDS[job.kind].part(parts, job, asked)}
    except SQLAlchemyError:
        raise
    except Exception as error:  # noqa: BLE001  (the job must know)
        answer = {"problem": _problem_of_any(error, job_id)}
    with writing(parts.database) as tx:
        tx.attempts.forget(entry)
    return answer


def _require_attempts_left(parts: Parts, job: JobRecord, deaths: Sequence[AttemptRecord]) -> None:
    """Raises ProcessDied where a job was begun as often as it may be."""
    if len(deaths) < parts.settings.job_attempts:
        return
    last = deaths[-1]
    how, _, traceback = (last.ended or "its worker died").partition("\n")
    raise ProcessDied(
        f"it was begun {len(deaths)} times, and its process or worker died each time; the last "
        f"time {how}, at the stage {job.stage!r} ({job.progress:.0%})",
        attempts=len(deaths),
        stage=job.stage,
        last=how,
        worker=last.worker,
        begun_at=last.begun_at,
        **({"traceback": traceback} if traceback else {}),
    )


def _problem_of_any(error: Exception, job_id: str) -> dict[str, Json]:
    if isinstance(error, TrueupError):
        return problem_of(error)
    if isinstance(error, MemoryError):
        return problem_of(MemoryLimit())
    log.exception("the job failed unexpectedly", extra={"job": job_id})
    return problem_of(
        TrueupError(
            f"the worker failed: {type(error).__name__}: {error}",
            hint="Read the worker's log.",
        )
    )


def finish(parts: Parts, job_id: str, computed: dict[str, Any]) -> str:
    """Closes a job with what `compute` returned, and returns its final state."""
    with reading(parts.database) as tx:
        job = find.job(tx, job_id)
    context, state = ActorContext(job.created_by, _now()), JobState(computed["state"])
    if "outcome" not in computed:
        _close(parts, job, state, computed.get("problem", {}), context)
        return state
    try:
        _finish(parts, job, state, computed["outcome"], context)
    except SQLAlchemyError as error:
        if not isinstance(error, DataError):
            raise  # the database, not the job: the engine tries this step again
        state = _failed(parts, job, error, context)
    except Exception as error:  # noqa: BLE001  (the job must end)
        state = _failed(parts, job, error, context)
    return state


def _failed(parts: Parts, job: JobRecord, error: Exception, context: ActorContext) -> JobState:
    """Closes a job whose outcome cannot be stored, and returns its state."""
    log.error(
        "the job could not be closed with what came of it", extra={"job": job.id}, exc_info=error
    )
    if not isinstance(error, TrueupError):
        error = TrueupError(f"{type(error).__name__}: {error}", hint="Read the worker's log.")
    _close(parts, job, JobState.FAILED, problem_of(error), context)
    return JobState.FAILED


def _finish(
    parts: Parts, job: JobRecord, state: JobState, outcome: dict[str, Any], context: ActorContext
) -> None:
    kind = KINDS[job.kind]
    with writing(parts.database) as tx:
        finish_job(
            tx,
            job,
            state,
            kind.result(outcome),
            context,
            lambda w: kind.effects(parts, w, job, outcome, context),
        )


def _close(
    parts: Parts, job: JobRecord, state: JobState, problem: dict[str, Json], context: ActorContext
) -> None:
    with writing(parts.database) as tx:
        finish_job(tx, job, state, {"problem": problem}, context)


def _now() -> str:
    return time_text(datetime.now(UTC))
