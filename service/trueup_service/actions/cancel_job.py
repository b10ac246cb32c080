"""Cancel a job: a waiting one at once, a running one at its next report of progress."""

from __future__ import annotations

from trueup_service.actions import find
from trueup_service.actor_context import ActorContext
from trueup_service.registry.records import FINAL, JobRecord, JobState
from trueup_service.registry.transaction import Transaction


def cancel_job(tx: Transaction, job: str, context: ActorContext) -> JobRecord:
    """Cancel a job, and return it as it stands then. A job in a final state stays as it is. Raises
    NotFound."""
    record = find.job(tx, job)
    if record.state in FINAL or record.state == JobState.CANCELLING:
        return record
    state = JobState.CANCELLED if record.state == JobState.QUEUED else JobState.CANCELLING
    stage = "cancelled" if state == JobState.CANCELLED else "cancelling"
    if tx.jobs.update(job, now=context.now, state=state, stage=stage, only_from=record.state):
        tx.log.append(
            context,
            "job:cancelled",
            plant=record.plant,
            subject=job,
            facts={"operation": record.operation, "was": record.state},
        )
    return find.job(tx, job)
