"""Finish a job: what came of it and the job's final state, in one transaction, once."""

from __future__ import annotations

from collections.abc import Callable

from trueup.canonical import Json
from trueup_service.actions.stamp import Stamp
from trueup_service.registry.records import JobRecord, JobState
from trueup_service.registry.store import Writer


def finish_job(
    writer: Writer,
    job: JobRecord,
    state: JobState,
    result: dict[str, Json],
    stamp: Stamp,
    effects: Callable[[Writer], None] = lambda _: None,
) -> bool:
    """Run the job's effects and close it; False, and nothing is done, if it was closed before."""
    if not writer.update_job(
        job.id,
        now=stamp.now,
        state=state,
        progress=1.0 if state == JobState.SUCCEEDED else None,
        stage=str(state),
        result=result,
    ):
        return False
    effects(writer)
    facts: dict[str, Json] = {
        "kind": job.kind,
        "operation": job.operation,
        "state": str(state),
        "reads": dict(writer.job_reads(job.id)),
        "result": result,
    }
    writer.append_audit(
        at=stamp.now,
        kind="job:finished",
        actor=stamp.actor,
        plant=job.plant,
        subject=job.id,
        facts=facts,
    )
    return True
