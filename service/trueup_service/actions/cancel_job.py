"""Cancel a job: at once if it waits, at its next report of progress if it runs."""

from __future__ import annotations

from trueup_service.actions import find
from trueup_service.actions.stamp import Stamp
from trueup_service.registry.records import FINAL, JobRecord, JobState
from trueup_service.registry.store import Writer


def cancel_job(writer: Writer, job: str, stamp: Stamp) -> JobRecord:
    """The job as it stands now; a final one is left as it is."""
    found = find.job(writer, job)
    if found.state in FINAL or found.state == JobState.CANCELLING:
        return found
    state = JobState.CANCELLED if found.state == JobState.QUEUED else JobState.CANCELLING
    stage = "cancelled" if state == JobState.CANCELLED else "cancelling"
    if writer.update_job(job, now=stamp.now, state=state, stage=stage, only_from=found.state):
        writer.append_audit(
            at=stamp.now,
            kind="job:cancelled",
            actor=stamp.actor,
            plant=found.plant,
            subject=job,
            facts={"operation": found.operation, "was": found.state},
        )
    return find.job(writer, job)
