"""The queue of jobs as it stands: what runs where, what waits behind what, and how long that takes
about, read with a few statements for all of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from statistics import median

from sqlalchemy import select

from trueup_service.registry import tables as t
from trueup_service.registry.attempts import FINISHED
from trueup_service.registry.records import JobRecord, JobState
from trueup_service.registry.transaction import ReadTransaction

REMEMBERED = 300  # of the newest finished attempts, by which the time of a kind of job is judged
APART = ("watch",)  # kinds that wait for no other job


@dataclass(frozen=True, slots=True)
class QueuedJob:
    """A job that has not ended: which worker runs it since when, the jobs before it in the order in
    which they were submitted, and how long it still waits and takes, about [s]; None where nothing
    is known of such jobs."""

    job: JobRecord
    worker: str | None
    begun_at: str | None
    ahead: tuple[JobRecord, ...]
    waits_s: float | None
    takes_s: float | None


def queued_jobs(tx: ReadTransaction, now: datetime) -> list[QueuedJob]:
    """All jobs of all plants that have not ended, the oldest first."""
    jobs = tx.jobs.under_way()
    begun = _begun(tx, [job.id for job in jobs])
    typical = _typical(tx)
    workers = max(1, len({worker for worker, _ in begun.values()}))
    listed: list[QueuedJob] = []
    for job in jobs:
        worker, begun_at = begun.get(job.id, (None, None))
        takes = typical.get((job.kind, job.plant), typical.get((job.kind, "")))
        runs = job.state != JobState.QUEUED
        before = [] if runs or job.kind in APART else [x for x in listed if x.job.kind not in APART]
        left = [_left(x, now) for x in before]
        known = [seconds for seconds in left if seconds is not None]
        waits = sum(known) / workers if len(known) == len(left) else None
        listed.append(QueuedJob(job, worker, begun_at, tuple(x.job for x in before), waits, takes))
    return listed


def _left(queued: QueuedJob, now: datetime) -> float | None:
    """How long a job still takes [s]: as long as its like, less what it has run."""
    if queued.begun_at is None or queued.takes_s is None:
        return queued.takes_s
    ran = (now - datetime.fromisoformat(queued.begun_at)).total_seconds()
    return max(queued.takes_s - ran, 0.0)


def _begun(tx: ReadTransaction, jobs: Sequence[str]) -> dict[str, tuple[str, str]]:
    """The worker of each job that has begun, and when it began."""
    of = t.attempts.c
    query = select(of.entry, of.worker, of.begun_at).where(of.entry.in_(jobs), of.ended.is_(None))
    rows = tx.connection.execute(query.order_by(of.number))
    return {row.entry: (row.worker, row.begun_at) for row in rows}


def _typical(tx: ReadTransaction) -> dict[tuple[str, str], float]:
    """How long jobs took [s], the median, by kind and plant, and by kind alone with no plant."""
    of = t.attempts.c
    newest = (
        select(of.entry, of.begun_at)
        .where(of.ended == FINISHED)
        .order_by(of.begun_at.desc())
        .limit(REMEMBERED)
        .subquery()
    )
    query = select(t.jobs.c.kind, t.jobs.c.plant, newest.c.begun_at, t.jobs.c.updated_at).where(
        t.jobs.c.id == newest.c.entry, t.jobs.c.state == JobState.SUCCEEDED
    )
    took: dict[tuple[str, str], list[float]] = {}
    for row in tx.connection.execute(query):
        begun, ended = map(datetime.fromisoformat, (row.begun_at, row.updated_at))
        for plant in (row.plant, ""):
            took.setdefault((row.kind, plant), []).append((ended - begun).total_seconds())
    return {of_jobs: median(seconds) for of_jobs, seconds in took.items()}
