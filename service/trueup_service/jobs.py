"""The job queue: a few calls to the job engine, which enqueue in the caller's transaction and share
parts of a running job among workers.

DBOS keeps its queue in the database of the registry, so that a job and its engine entry commit
together. It is imported on first use: a server that only serves never loads it.
"""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property
from typing import TYPE_CHECKING

from sqlalchemy import Connection, Engine, make_url

if TYPE_CHECKING:
    from trueup_service.engine import DBOSClient, EnqueueOptions

QUEUE = "trueup"
# Looks at new episodes take milliseconds, and must not wait for a diagnosis.
WATCHING = "trueup.watching"
WORKFLOW = "trueup.job"
HELP = "trueup.help"
AFTER_JOBS = 1  # the priority of parts of jobs: a waiting job is begun first
# Of what is queued, not of the code: a new release must take up what an old one queued.
ENGINE_VERSION = "1"


class Helped(StrEnum):
    """The state of a part of a job."""

    WAITING = "waiting"
    TAKEN = "taken"
    DONE = "done"
    FAILED = "failed"

    @staticmethod
    def of(status: str) -> Helped:
        """The state for a status of the engine."""
        known = {
            "ENQUEUED": Helped.WAITING,
            "DELAYED": Helped.WAITING,
            "PENDING": Helped.TAKEN,
            "SUCCESS": Helped.DONE,
        }
        return known.get(status, Helped.FAILED)


@dataclass(frozen=True, slots=True)
class Help:
    """One part of a job as it stands, with the result of its worker."""

    state: Helped
    answer: str | None


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
        self._client.enqueue_in_transaction(connection, options, job)

    def knows(self, job: str) -> bool:
        """Whether the engine has an entry of a job."""
        return bool(
            self._client.list_workflows(workflow_ids=[job], load_input=False, load_output=False)
        )

    def ask_for_help(self, job: str, parcels: Mapping[str, str]) -> None:
        """Queue parts of a running job by name, for workers that have nothing else to do. A part
        that is queued already stays as it is."""
        with self._engine.begin() as connection:
            for name, parcel in parcels.items():
                options: EnqueueOptions = {
                    "workflow_name": HELP,
                    "queue_name": QUEUE,
                    "workflow_id": name,
                    "app_version": ENGINE_VERSION,
                    "priority": AFTER_JOBS,
                }
                self._client.enqueue_in_transaction(connection, options, job, parcel)

    def help(self, names: Sequence[str]) -> dict[str, Help]:
        """The parts of these names as they stand. A part that is missing was withdrawn."""
        workflows = self._client.list_workflows(workflow_ids=list(names), load_input=False)
        return {w.workflow_id: Help(Helped.of(w.status), w.output) for w in workflows}

    def withdraw(self, names: Sequence[str]) -> None:
        """Cancel parts that are not needed any more."""
        if names:
            self._client.cancel_workflows(list(names))

    def forget(self, prefix: str) -> None:
        """Delete every part whose name begins with a prefix."""
        if names := self.names(prefix):
            self._client.delete_workflows(names)

    def names(self, prefix: str) -> list[str]:
        """The names of all parts that begin with a prefix."""
        return [
            w.workflow_id
            for w in self._client.list_workflows(
                workflow_id_prefix=prefix, load_input=False, load_output=False
            )
        ]

    @cached_property
    def _client(self) -> DBOSClient:
        from trueup_service.engine import DBOSClient, DBOSPortableJSONSerializer  # noqa: PLC0415  (1.2 s of imports)

        migrate_engine(self._url)
        return DBOSClient(
            system_database_engine=self._engine, serializer=DBOSPortableJSONSerializer()
        )


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
