"""The job queue: a few calls to the job engine, which enqueue in the caller's transaction, and
spread the parts of a running job over all workers.

DBOS keeps its queue in the database of the registry, so that a job and its engine entry commit
together. It is imported on first use: a server that only serves never loads it.
"""

from __future__ import annotations

import threading
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from enum import StrEnum
from functools import cached_property
from typing import TYPE_CHECKING, Any

from sqlalchemy import Connection, Engine, make_url, text

from trueup.canonical import Json
from trueup_service import open_telemetry

if TYPE_CHECKING:
    from trueup_service.engine import DBOSClient, EnqueueOptions

QUEUE = "trueup"
# Looks at new episodes take milliseconds, and must not wait for a diagnosis.
WATCHING = "trueup.watching"
# Parts of jobs run on one core each, beside the job that waits for them.
PARTS = "trueup.parts"
# Deliveries of events wait for other machines, and take no core.
WEBHOOKS = "trueup.webhooks"
WORKFLOW = "trueup.job"
PART = "trueup.part"
DELIVERY = "trueup.delivery"
PART_PREFIX = "part."  # of a part's name; the job's id and the digest of what is asked follow
# Of what is queued, not of the code: a new release must take up what an old one queued.
ENGINE_VERSION = "1"
# A PostgreSQL channel on which sleeping workers hear of a new job.
CHANNEL = "trueup_jobs"
SUCCEEDED = ("SUCCESS", "CANCELLED")
FAILED = ("ERROR", "MAX_RECOVERY_ATTEMPTS_EXCEEDED")
DELETED_AT_ONCE = 500  # entries of the engine in one transaction


class PartState(StrEnum):
    """The state of a part of a job."""

    UNDER_WAY = "under way"
    DONE = "done"
    FAILED = "failed"

    @staticmethod
    def of(status: str) -> PartState:
        """The state for a status of the engine."""
        known = {
            "ENQUEUED": PartState.UNDER_WAY,
            "DELAYED": PartState.UNDER_WAY,
            "PENDING": PartState.UNDER_WAY,
            "SUCCESS": PartState.DONE,
        }
        return known.get(status, PartState.FAILED)


@dataclass(frozen=True, slots=True)
class JobPart:
    """A part of a job as it stands, with its answer once it is done."""

    state: PartState
    answer: Any


class JobQueue:
    """Hands jobs and parts of jobs to the engine."""

    def __init__(self, url: str, engine: Engine) -> None:
        self._url, self._engine = url, engine
        self._lock = threading.Lock()

    def prepare(self) -> None:
        """Load the engine and bring its tables up to date. This takes transactions of its own, so
        it is called outside of any."""
        with self._lock:
            self._client  # noqa: B018

    def enqueue(self, connection: Connection, job: str, kind: str, plant: str) -> None:
        """Queue a job in the caller's transaction. The id of the job is that of the workflow, so a
        second call changes nothing."""
        options: EnqueueOptions = {
            "workflow_name": WORKFLOW,
            "queue_name": queue_of(kind),
            "workflow_id": job,
            "app_version": ENGINE_VERSION,
        }
        if (alone := alone_with(kind, plant)) is not None:
            options["queue_partition_key"] = alone
        self._client.enqueue_in_transaction(connection, options, job, *_trace())
        self._notify(connection)

    def enqueue_delivery(self, connection: Connection, entry: str, webhook: str) -> None:
        """Queue a delivery of events to a webhook in the caller's transaction."""
        options: EnqueueOptions = {
            "workflow_name": DELIVERY,
            "queue_name": WEBHOOKS,
            "workflow_id": entry,
            "app_version": ENGINE_VERSION,
        }
        self._client.enqueue_in_transaction(connection, options, webhook)
        self._notify(connection)

    def knows(self, job: str) -> bool:
        """Whether the engine has an entry of a job."""
        return bool(
            self._client.list_workflows(workflow_ids=[job], load_input=False, load_output=False)
        )

    def spread(self, job: str, parts: Mapping[str, Json]) -> None:
        """Queue parts of a running job by name, for whichever worker has a core to spare. A part
        that is queued already stays as it is."""
        if not parts:
            return
        with self._engine.begin() as connection:
            for name, asked in parts.items():
                options: EnqueueOptions = {
                    "workflow_name": PART,
                    "queue_name": PARTS,
                    "workflow_id": name,
                    "app_version": ENGINE_VERSION,
                }
                self._client.enqueue_in_transaction(connection, options, job, asked, *_trace())
            self._notify(connection)

    def parts(self, names: Sequence[str]) -> dict[str, JobPart]:
        """The parts of these names as they stand. One that nobody queued, or that was removed, is
        missing."""
        states = {
            w.workflow_id: PartState.of(w.status)
            for w in self._client.list_workflows(
                workflow_ids=list(names), load_input=False, load_output=False
            )
        }
        done = [name for name, state in states.items() if state is PartState.DONE]
        answers = {
            w.workflow_id: w.output
            for w in (
                self._client.list_workflows(workflow_ids=done, load_input=False) if done else ()
            )
        }
        return {name: JobPart(state, answers.get(name)) for name, state in states.items()}

    def resume(self, name: str) -> None:
        """Queue a part again that the engine gave up on."""
        self._client.resume_workflow(name, queue_name=PARTS)

    def remove(self, names: Sequence[str]) -> None:
        """Cancel parts that are not needed any more, and delete them."""
        if names:
            self._client.cancel_workflows(list(names))
            self._client.delete_workflows(list(names))

    def names(self, prefix: str) -> list[str]:
        """The names of all entries that begin with a prefix."""
        return [
            w.workflow_id
            for w in self._client.list_workflows(
                workflow_id_prefix=prefix, load_input=False, load_output=False
            )
        ]

    def purge(self, before: datetime, unfinished: Collection[str]) -> int:
        """Delete the entries that ended before a time, with all that the engine keeps of them, and
        return how many there were. Failed entries of jobs that are `unfinished` stay, because such
        a job is tried again."""
        count = 0
        while names := self._ended(SUCCEEDED, before, DELETED_AT_ONCE):
            self._client.delete_workflows(names)
            count += len(names)
        failed = [
            name
            for name in self._ended(FAILED, before)
            if not any(job in name for job in unfinished)
        ]
        for begin in range(0, len(failed), DELETED_AT_ONCE):
            self._client.delete_workflows(failed[begin : begin + DELETED_AT_ONCE])
        return count + len(failed)

    def _ended(
        self, statuses: Sequence[str], before: datetime, limit: int | None = None
    ) -> list[str]:
        return [
            w.workflow_id
            for w in self._client.list_workflows(
                status=list(statuses),
                completed_before=before.isoformat(),
                limit=limit,
                load_input=False,
                load_output=False,
            )
        ]

    def _notify(self, connection: Connection) -> None:
        """Wake sleeping workers once the transaction commits. On SQLite they see it commit."""
        if connection.dialect.name == "postgresql":
            connection.execute(text(f"NOTIFY {CHANNEL}"))

    @cached_property
    def _client(self) -> DBOSClient:
        from trueup_service.engine import DBOSClient, DBOSPortableJSONSerializer  # noqa: PLC0415  (1.2 s of imports)

        migrate_engine(self._url)
        return DBOSClient(
            system_database_engine=self._engine, serializer=DBOSPortableJSONSerializer()
        )


def _trace() -> tuple[str, ...]:
    """The present trace as a last argument of what is queued, where there is one."""
    trace = open_telemetry.traceparent()
    return () if trace is None else (trace,)


def queue_of(kind: str) -> str:
    """The queue of the jobs of a kind."""
    return WATCHING if kind == "watch" else QUEUE


def alone_with(kind: str, plant: str) -> str | None:
    """The key under which no two jobs of a kind run at once, None where any may: two looks at one
    plant would both count the same episodes."""
    return plant if kind == "watch" else None


def migrate_engine(url: str) -> None:
    """Create or update the engine's tables."""
    import logging  # noqa: PLC0415

    from trueup_service.engine import DBOS  # noqa: PLC0415

    logging.getLogger("dbos").setLevel(logging.WARNING)
    DBOS.migrate(plain_url(url))


def plain_url(url: str) -> str:
    """A database URL without its driver, as the engine takes it."""
    parsed = make_url(url)
    return parsed.set(drivername=parsed.get_backend_name()).render_as_string(hide_password=False)
