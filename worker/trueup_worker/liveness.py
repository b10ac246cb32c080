"""Liveness: which workers are alive, by locks that end with their process.

Each worker holds a lock under its own name for as long as it lives: a file lock beside an embedded
database, a session's advisory lock in PostgreSQL. Whoever acquires a worker's lock knows that the
worker is gone, so no clock decides who is dead.
"""

from __future__ import annotations

import hashlib
import os
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from sqlalchemy import Connection, text
from sqlalchemy.exc import SQLAlchemyError

from trueup_service.locks import try_lock
from trueup_service.registry.database import Database
from trueup_service.wiring import Parts


class Liveness(ABC):
    """The locks of the workers."""

    @abstractmethod
    def acquire(self, name: str) -> None:
        """Acquires the lock of this worker, until the process ends."""

    @abstractmethod
    @contextmanager
    def try_acquire(self, name: str) -> Iterator[bool]:
        """Holds the lock of another worker for the block; False if that worker is alive."""

    @abstractmethod
    def is_held(self) -> bool:
        """Whether this worker still holds its own lock."""


class FileLiveness(Liveness):
    """Locks as files, for workers of one machine."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._own: int | None = None

    def acquire(self, name: str) -> None:
        self._own = try_lock(self._path(name))

    @contextmanager
    def try_acquire(self, name: str) -> Iterator[bool]:
        handle = try_lock(self._path(name))
        try:
            yield handle is not None
        finally:
            if handle is not None:
                os.close(handle)

    def is_held(self) -> bool:
        return True  # a file lock ends with the process alone

    def _path(self, name: str) -> Path:
        return self._folder / f"{name}.lock"


class PostgresLiveness(Liveness):
    """Locks of PostgreSQL sessions, for workers of many machines."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self._own: Connection | None = None

    def acquire(self, name: str) -> None:
        self._own = self._database.engine.connect().execution_options(isolation_level="AUTOCOMMIT")
        self._own.execute(text("SELECT pg_advisory_lock(:key)"), {"key": _key(name)})

    @contextmanager
    def try_acquire(self, name: str) -> Iterator[bool]:
        query = text("SELECT pg_try_advisory_xact_lock(:key)")
        with self._database.engine.connect() as connection:
            yield bool(connection.scalar(query, {"key": _key(name)}))

    def is_held(self) -> bool:
        """Whether the session with the lock lives. Asking keeps it from being closed as idle."""
        try:
            return self._own is not None and self._own.scalar(text("SELECT 1")) == 1
        except SQLAlchemyError:
            return False


def liveness_of(parts: Parts) -> Liveness:
    """Returns the locks that fit the service's storage."""
    if parts.settings.embedded:
        return FileLiveness(parts.settings.data_dir / "workers")
    return PostgresLiveness(parts.database)


def _key(name: str) -> int:
    return int.from_bytes(hashlib.sha256(name.encode()).digest()[:8], "big", signed=True)
