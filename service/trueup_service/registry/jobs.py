"""Jobs, what they have read, and the files that they left behind."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from sqlalchemy import bindparam, func, select, update

from trueup.canonical import Json
from trueup_service.registry import tables as t
from trueup_service.registry.episodes import equal_samples
from trueup_service.registry.records import FINAL, NOTHING_CAME, JobRecord, JobState, OutputRecord
from trueup_service.registry.repository import Repository
from trueup_service.registry.row_format import document_text

UNFINISHED = tuple(state for state in JobState if state not in FINAL)
SEARCHED_JOBS = 200  # of one kind, the newest


class Jobs(Repository[JobRecord]):
    """Jobs of plants."""

    table, record = t.jobs, JobRecord

    def get(self, job: str) -> JobRecord | None:
        """A job by its id."""
        return self._by(id=job)

    def page(self, plant: str, before: str, limit: int) -> list[JobRecord]:
        """Jobs created before a time, the newest first."""
        of = t.jobs.c
        return self._newest(of.created_at, of.id, before, limit, of.plant == plant)

    def unfinished(self) -> list[str]:
        """The ids of all jobs of all plants that have not ended, the oldest first."""
        query = select(t.jobs.c.id).where(t.jobs.c.state.in_(UNFINISHED))
        return list(self._connection.scalars(query.order_by(t.jobs.c.created_at)))

    def under_way(self) -> list[JobRecord]:
        """All jobs of all plants that have not ended, the oldest first."""
        query = select(t.jobs).where(t.jobs.c.state.in_(UNFINISHED))
        return self._all(query.order_by(t.jobs.c.created_at, t.jobs.c.id))

    def has_unfinished(self) -> bool:
        """Whether a job of any plant has not ended."""
        query = select(t.jobs.c.id).where(t.jobs.c.state.in_(UNFINISHED))  # which its index finds
        return self._connection.scalar(query.limit(1)) is not None

    def last(self, plant: str, kind: str) -> JobRecord | None:
        """The newest job of a kind."""
        return self._last("created_at", plant=plant, kind=kind)

    def last_succeeded(self, plant: str, kind: str) -> JobRecord | None:
        """The newest job of a kind that has succeeded."""
        return self._last("created_at", plant=plant, kind=kind, state=JobState.SUCCEEDED)

    def newest_succeeded(self, plant: str, kind: str, limit: int) -> list[JobRecord]:
        """The newest jobs of a kind that have succeeded, the newest first."""
        query = (
            select(t.jobs)
            .where(
                t.jobs.c.plant == plant,
                t.jobs.c.kind == kind,
                t.jobs.c.state == JobState.SUCCEEDED,
            )
            .order_by(t.jobs.c.created_at.desc())
            .limit(limit)
        )
        return [self._record(row) for row in self._connection.execute(query)]

    def last_matching(
        self, plant: str, kind: str, matches: Callable[[Mapping[str, Any]], bool]
    ) -> JobRecord | None:
        """The newest job of a kind whose request matches, among the newest SEARCHED_JOBS."""
        query = (
            select(t.jobs)
            .where(t.jobs.c.plant == plant, t.jobs.c.kind == kind)
            .order_by(t.jobs.c.created_at.desc())
            .limit(SEARCHED_JOBS)
        )
        jobs = map(self._record, self._connection.execute(query))
        return next((job for job in jobs if matches(job.request)), None)

    def last_with_output(self, plant: str, kind: str, name: str) -> JobRecord | None:
        """The newest job of a kind that left a file of a name behind."""
        left = select(t.outputs.c.job).where(t.outputs.c.plant == plant, t.outputs.c.name == name)
        query = select(t.jobs).where(
            t.jobs.c.plant == plant, t.jobs.c.kind == kind, t.jobs.c.id.in_(left)
        )
        return self._one(query.order_by(t.jobs.c.created_at.desc()).limit(1))

    def is_queued(self, plant: str, kind: str) -> bool:
        """Whether a job of this kind has not begun yet."""
        query = select(t.jobs.c.id).where(
            t.jobs.c.plant == plant, t.jobs.c.kind == kind, t.jobs.c.state == JobState.QUEUED
        )
        return self._connection.scalar(query.limit(1)) is not None

    def has_trial(self, plant: str) -> bool:
        """Whether a trial of the plant is under way or has succeeded."""
        query = select(t.jobs.c.id).where(
            t.jobs.c.plant == plant, t.jobs.c.kind == "gate", t.jobs.c.state.not_in(NOTHING_CAME)
        )
        return self._connection.scalar(query.limit(1)) is not None

    def candidates_on_trial(self, plant: str) -> list[str]:
        """The candidates of a plant's trials that have not ended, the newest trial first."""
        query = select(t.jobs).where(
            t.jobs.c.plant == plant, t.jobs.c.kind == "gate", t.jobs.c.state.not_in(FINAL)
        )
        trials = self._all(query.order_by(t.jobs.c.created_at.desc(), t.jobs.c.id))
        return [str(job.request["candidate"]) for job in trials]

    def update(
        self,
        job: str,
        *,
        now: str,
        state: JobState | None = None,
        progress: float | None = None,
        stage: str | None = None,
        result: dict[str, Json] | None = None,
        only_from: str | None = None,
    ) -> bool:
        """Change where a job stands, except for what is None.

        Returns False, and changes nothing, where the job is in a final state, which never changes,
        or is not in the state `only_from`.
        """
        changes = {
            "state": state and str(state),
            "progress": progress,
            "stage": stage,
            "result": None if result is None else document_text(result),
        }
        values = {name: value for name, value in changes.items() if value is not None}
        this_job = t.jobs.c.id == job
        leaves = t.jobs.c.state.not_in(FINAL) if only_from is None else t.jobs.c.state == only_from
        changed = self._gateway.update(update(t.jobs), this_job, leaves, **values, updated_at=now)
        if state in FINAL and changed:
            self._gateway.note_changed(t.jobs, this_job)
        return changed

    def reads(self, job: str) -> dict[str, str]:
        """What a job has read: each digest, and the purpose it was read for."""
        rows = self._connection.execute(
            select(t.job_reads.c.digest, t.job_reads.c.purpose)
            .where(t.job_reads.c.job == job)
            .order_by(t.job_reads.c.digest)
        )
        return {row.digest: row.purpose for row in rows}

    def add_reads(self, job: str, digests: Sequence[str], purpose: str) -> None:
        """Note what a job reads. A digest that is noted already keeps its purpose."""
        known = self.reads(job)
        for digest in digests:
            if digest not in known:
                row = {"job": job, "digest": digest, "purpose": purpose}
                self._gateway.add(t.job_reads, row)

    def reading(self, digests: Sequence[str], purpose: str) -> list[JobRecord]:
        """Every job that read any of these bytes for a purpose, in the order of submission."""
        reads = select(t.job_reads.c.job).where(
            t.job_reads.c.purpose == purpose,
            t.job_reads.c.digest.in_(bindparam("digests", expanding=True)),
        )
        query = (
            select(t.jobs).where(t.jobs.c.id.in_(reads)).order_by(t.jobs.c.created_at, t.jobs.c.id)
        )
        jobs = map(self._record, self._gateway.in_parts(query, "digests", digests))
        return list({job.id: job for job in jobs}.values())

    def count_uses(self, digest: str, purpose: str) -> int:
        """How many jobs of all plants have read these samples for a purpose. Jobs that failed or
        were cancelled do not count."""
        query = (
            select(func.count())
            .select_from(t.job_reads.join(t.jobs, t.jobs.c.id == t.job_reads.c.job))
            .where(
                (t.job_reads.c.digest == digest) | t.job_reads.c.digest.in_(equal_samples(digest)),
                t.job_reads.c.purpose == purpose,
                t.jobs.c.state.not_in(NOTHING_CAME),
            )
        )
        return int(self._connection.scalar(query) or 0)


class Outputs(Repository[OutputRecord]):
    """Files that jobs left behind."""

    table, record = t.outputs, OutputRecord

    def get(self, job: str, name: str) -> OutputRecord | None:
        """A file of a job by its name."""
        return self._by(job=job, name=name)

    def of_job(self, job: str) -> list[OutputRecord]:
        """The files of a job by name."""
        return self._all(select(t.outputs).where(t.outputs.c.job == job).order_by(t.outputs.c.name))
