"""Take over the jobs of dead workers.

Each worker holds a lock under its own name for as long as it lives: a file lock beside an embedded
database, a session's advisory lock in PostgreSQL. Nobody's clock decides who is dead: whoever gets
a worker's lock knows that it is gone, and resumes what it had begun. A worker cut off from its
database may still be computing; its effects are refused, for the job is finished once.
"""

from __future__ import annotations

import hashlib
import logging
import os
import threading
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path

from sqlalchemy import Connection, text
from sqlalchemy.exc import IntegrityError, SQLAlchemyError

from trueup.canonical import Json
from trueup_service.actions.finish_job import finish_job
from trueup_service.actor_context import ActorContext, time_text
from trueup_service.engine import DBOS, SetWorkflowID
from trueup_service.jobs import ENGINE_VERSION, QUEUE, alone_with, queue_of
from trueup_service.locks import try_lock
from trueup_service.registry.database import Database
from trueup_service.registry.records import FINAL, JobRecord, JobState
from trueup_service.registry.transaction import reading, writing

log = logging.getLogger("trueup.worker")

AGAIN = "-"  # between a job and the number of an attempt after its first
ATTEMPTS = 5  # each of which the engine tried for a minute


class Lives(ABC):
    """Who is alive."""

    @abstractmethod
    def begin(self, name: str) -> None:
        """Hold the lock of this name until the process ends."""

    @abstractmethod
    @contextmanager
    def seize(self, name: str) -> Iterator[bool]:
        """Hold the lock of another name for a while, if its holder is gone."""


class FileLives(Lives):
    """Locks as files, for workers of one machine."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._own: int | None = None

    def begin(self, name: str) -> None:
        self._own = try_lock(self._path(name))

    @contextmanager
    def seize(self, name: str) -> Iterator[bool]:
        handle = try_lock(self._path(name))
        try:
            yield handle is not None
        finally:
            if handle is not None:
                os.close(handle)

    def _path(self, name: str) -> Path:
        return self._folder / f"{name}.lock"


class PostgresLives(Lives):
    """Locks of PostgreSQL sessions, for workers of many machines."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self._own: Connection | None = None

    def begin(self, name: str) -> None:
        self._own = self._database.engine.connect().execution_options(isolation_level="AUTOCOMMIT")
        self._own.execute(text("SELECT pg_advisory_lock(:key)"), {"key": _key(name)})

    def holds(self) -> bool:
        """Whether the session that holds our own lock still lives; asking keeps it from being
        closed as idle."""
        try:
            return self._own is not None and self._own.scalar(text("SELECT 1")) == 1
        except SQLAlchemyError:
            return False

    @contextmanager
    def seize(self, name: str) -> Iterator[bool]:
        with self._database.engine.connect() as connection:
            yield bool(
                connection.scalar(
                    text("SELECT pg_try_advisory_xact_lock(:key)"), {"key": _key(name)}
                )
            )


def _key(name: str) -> int:
    return int.from_bytes(hashlib.sha256(name.encode()).digest()[:8], "big", signed=True)


def take_over(lives: Lives, own: str) -> list[str]:
    """Put what dead workers had begun back into the queue; the jobs' ids."""
    pending = DBOS.list_workflows(status="PENDING", load_input=False, load_output=False)
    resumed = []
    for name in sorted({w.executor_id for w in pending if w.executor_id and w.executor_id != own}):
        with lives.seize(name) as gone:
            if gone:
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


def revive(database: Database) -> list[str]:
    """Begin again what the engine gave up on, at the step that failed, such as a job that could not
    be closed while the database was away; the jobs' ids. What is given up on ATTEMPTS times fails.
    """
    given_up = DBOS.list_workflows(status="ERROR", load_input=False, load_output=False)
    revived = []
    for job in sorted({w.workflow_id.split(AGAIN)[0] for w in given_up}):
        with reading(database) as tx:
            found = tx.jobs.get(job)
        if found is None or found.state in FINAL:
            continue
        attempts = DBOS.list_workflows(workflow_id_prefix=job, load_input=False, load_output=False)
        if any(a.status != "ERROR" for a in attempts):
            continue
        if len(attempts) >= ATTEMPTS:
            _fail(database, found)
        else:
            last = max(
                attempts, key=lambda a: (a.created_at or 0, len(a.workflow_id), a.workflow_id)
            )
            try:
                _begin_again(found, last.workflow_id, len(attempts))
            except IntegrityError:
                continue  # another worker was quicker
            revived.append(job)
    return revived


def _begin_again(job: JobRecord, last: str, attempts: int) -> None:
    """One more attempt under a name that only one worker can take."""
    steps = DBOS.list_workflow_steps(last)
    failed = next((s["function_id"] for s in steps if s["error"] is not None), len(steps) + 1)
    with SetWorkflowID(f"{job.id}{AGAIN}{attempts}"):
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
    with writing(database) as tx:
        finish_job(
            tx,
            job,
            JobState.FAILED,
            {"problem": problem},
            ActorContext(job.created_by, time_text(datetime.now(UTC))),
        )
    log.error("given up", extra={"job": job.id})


def watch(
    database: Database, lives: Lives, own: str, interval_s: float, stop: threading.Event
) -> None:
    """Look for dead workers until told to stop."""
    while not stop.wait(interval_s):
        try:
            if isinstance(lives, PostgresLives) and not lives.holds():
                log.error("the session that shows this worker alive is gone; stopping")
                os._exit(75)  # EX_TEMPFAIL: somebody else may already be running our job
            take_over(lives, own)
            revive(database)
        except Exception:
            log.exception("looking for dead workers failed; looking again")
