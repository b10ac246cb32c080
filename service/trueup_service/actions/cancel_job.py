"""Cancel a job: at once if it waits, at its next report of progress if it runs."""

from __future__ import annotations

from trueup_service.actions import find
from trueup_service.actor_context import ActorContext
from trueup_service.registry.records import FINAL, JobRecord, JobState
from trueup_service.registry.transaction import Transaction


def cancel_job(tx: Transaction, job: str, context: ActorContext) -> JobRecord:
    """The job as it stands now; a final one is left as it is."""
    found = find.job(tx, job)
    if found.state in FINAL or found.state == JobState.CANCELLING:
        return found
    state = JobState.CANCELLED if found.state == JobState.QUEUED else JobState.CANCELLING
    stage = "cancelled" if state == JobState.CANCELLED else "cancelling"
    if tx.jobs.update(job, now=context.now, state=state, stage=stage, only_from=found.state):
        tx.log.append(
            context,
            "job:cancelled",
            plant=found.plant,
            subject=job,
            facts={"operation": found.operation, "was": found.state},
        )
    return find.job(tx, job)
