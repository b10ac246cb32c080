"""The database engine and its transactions, on SQLite and PostgreSQL.

SQLite keeps a write-ahead log with `synchronous=FULL`, so that a commit is on disk when it returns.
Writers take SQLite's write lock when they begin. Within one process they first queue on a lock of
ours, because SQLite itself waits by sleeping and trying again.
"""

from __future__ import annotations

import shutil
import sqlite3
import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager, nullcontext
from pathlib import Path
from typing import Any

from sqlalchemy import Connection, Engine, create_engine, event, make_url

BUSY_TIMEOUT_MS = 30_000
_WRITES = "trueup_writes"


class Database:
    """The database. Its context managers give a connection inside a transaction. A transaction that
    writes commits when it is left, and rolls back on an error."""

    def __init__(self, url: str, pool: int) -> None:
        self._url = url
        self.is_sqlite = url.startswith("sqlite")
        self.engine = (
            _sqlite_engine(url, pool)
            if self.is_sqlite
            else create_engine(url, pool_size=pool, max_overflow=0, hide_parameters=True)
        )
        self._queue: Any = threading.Lock() if self.is_sqlite else nullcontext()

    @contextmanager
    def read(self) -> Iterator[Connection]:
        """A transaction that only reads."""
        with self.engine.connect() as connection:
            yield connection

    @contextmanager
    def snapshot(self) -> Iterator[Connection]:
        """A transaction in which every statement reads the same state, while others write."""
        level = {} if self.is_sqlite else {"isolation_level": "REPEATABLE READ"}
        with self.engine.connect().execution_options(**level) as connection:
            yield connection

    @contextmanager
    def glance(self) -> Iterator[Connection]:
        """A connection for one statement that reads. No transaction is begun or ended, which saves
        two round trips to PostgreSQL."""
        with self.engine.connect().execution_options(isolation_level="AUTOCOMMIT") as connection:
            yield connection

    @contextmanager
    def write(self) -> Iterator[Connection]:
        """A transaction that commits when it is left without an error."""
        with self._queue, self.connect_to_write() as connection, connection.begin():
            yield connection

    @contextmanager
    def write_on(self, connection: Connection) -> Iterator[None]:
        """A transaction as `write` gives, on a connection of `connect_to_write`."""
        with self._queue, connection.begin():
            yield

    def connect_to_write(self) -> Connection:
        """A connection whose transactions write. Kept open it keeps what it has read of the
        database, until another connection writes."""
        return self.engine.connect().execution_options(**{_WRITES: True})

    def change_counter(self) -> ChangeCounter | None:
        """A counter of commits, None where the database has none that is cheaper than a query."""
        return ChangeCounter(self._url) if self.is_sqlite else None

    def close(self) -> None:
        """Close every connection."""
        self.engine.dispose()


def copy_sqlite(database: Path, folder: Path) -> Path:
    """Copy an SQLite database into a folder as it is at one moment, and return the copy's path.
    Raises OSError, sqlite3.Error."""
    to = folder / database.name
    try:
        with (
            closing(sqlite3.connect(f"{database.as_uri()}?mode=ro", uri=True)) as source,
            closing(sqlite3.connect(to)) as target,
        ):
            source.backup(target)
    except (
        sqlite3.OperationalError
    ):  # SQLite needs an index beside the write-ahead log, and cannot make one here
        for name in (database.name, f"{database.name}-wal"):
            if (source_file := database.with_name(name)).exists():
                shutil.copyfile(source_file, folder / name)
    return to


class ChangeCounter:
    """SQLite's own counter of commits, read through a connection that does nothing else.

    The counter that a connection sees moves with every commit by any other connection, in this
    process or another one. A connection does not see its own commits, so this one never writes.
    Source: SQLite documentation, PRAGMA data_version.
    """

    def __init__(self, url: str) -> None:
        self._connection = sqlite3.connect(
            make_url(url).database or "", check_same_thread=False, isolation_level=None
        )
        self._seen = -1

    def moved(self) -> bool:
        """Whether there was a commit since the last call."""
        (now,) = self._connection.execute("PRAGMA data_version").fetchone()
        moved, self._seen = now != self._seen, now
        return bool(moved)


def _sqlite_engine(url: str, pool: int) -> Engine:
    engine = create_engine(
        url,
        pool_size=pool + 1,  # one is the writer's
        max_overflow=0,
        pool_use_lifo=True,  # the connection used last has read most of what is asked next
        hide_parameters=True,  # which may be secrets, and would stand in the log with an error
        connect_args={"timeout": BUSY_TIMEOUT_MS / 1000, "check_same_thread": False},
    )

    @event.listens_for(engine, "connect")
    def _prepare(connection: sqlite3.Connection, _record: object) -> None:
        connection.isolation_level = None
        for pragma in (
            f"busy_timeout={BUSY_TIMEOUT_MS}",
            "journal_mode=WAL",
            "synchronous=FULL",
            "foreign_keys=ON",
        ):
            connection.execute(f"PRAGMA {pragma}")

    @event.listens_for(engine, "begin")
    def _begin(connection: Connection) -> None:
        connection.exec_driver_sql(
            "BEGIN IMMEDIATE" if connection.get_execution_options().get(_WRITES) else "BEGIN"
        )

    return engine
