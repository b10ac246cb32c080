"""Finish a job: write its effects and its final state in one transaction, once."""

from __future__ import annotations

from collections.abc import Callable

from trueup.canonical import Json
from trueup_service.actor_context import ActorContext
from trueup_service.registry.records import JobRecord, JobState
from trueup_service.registry.transaction import Transaction


def finish_job(
    tx: Transaction,
    job: JobRecord,
    state: JobState,
    result: dict[str, Json],
    context: ActorContext,
    effects: Callable[[Transaction], None] = lambda _: None,
) -> bool:
    """Run a job's effects and close it. Returns False, and changes nothing, where it was closed
    before."""
    if not tx.jobs.update(
        job.id,
        now=context.now,
        state=state,
        progress=1.0 if state == JobState.SUCCEEDED else None,
        stage=str(state),
        result=result,
    ):
        return False
    tx.attempts.finish(job.id)
    effects(tx)
    facts: dict[str, Json] = {
        "kind": job.kind,
        "operation": job.operation,
        "state": str(state),
        "reads": dict(tx.jobs.reads(job.id)),
        "result": result,
    }
    tx.log.append(context, "job:finished", plant=job.plant, subject=job.id, facts=facts)
    return True
