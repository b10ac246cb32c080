"""Sleeping: an idle worker waits until a job is queued, and costs next to nothing meanwhile.

The job engine looks at its queues all the time. So it runs only while a job of any plant has not
ended. Sleeping workers hear of a new job: PostgreSQL notifies them when the transaction commits
that queued it; of SQLite they read the counter of commits, which takes microseconds, and ask for
jobs when it has moved.
"""

from __future__ import annotations

import logging
import math
import threading
import time
from collections.abc import Callable
from typing import Any

from sqlalchemy import text
from sqlalchemy.exc import SQLAlchemyError

from trueup_service.jobs import CHANNEL
from trueup_service.registry.database import Database
from trueup_service.registry.transaction import reading

log = logging.getLogger("trueup.worker")

COUNTER_S = 0.1  # between looks at SQLite's counter of commits
LISTENING_S = 1.0  # that one wait for a notification takes, so that a stop is noticed
LOOK_S = 30.0  # between looks without any notification, in case one was lost
RETRY_S = 1.0  # until a lost database is tried again


def sleep_until_work(
    database: Database, stop: threading.Event, look: Callable[[], None] = lambda: None
) -> None:
    """Returns once a job or a delivery of events has not ended, or `stop` is set. Calls `look`
    every LOOK_S."""
    while not stop.is_set():
        try:
            if database.is_sqlite:
                _until_sqlite_has_work(database, stop)
            else:
                _until_postgres_has_work(database, stop, look)
            return
        except SQLAlchemyError:
            log.exception("waiting for jobs failed; waiting again")
            stop.wait(RETRY_S)


def has_work(database: Database) -> bool:
    """Whether a job of any plant, or a delivery of events, has not ended."""
    with reading(database) as tx:
        return tx.jobs.has_unfinished() or bool(tx.webhook_cursors.under_way())


def _until_sqlite_has_work(database: Database, stop: threading.Event) -> None:
    counter = database.change_counter()
    assert counter is not None
    while not stop.is_set():
        if counter.moved() and has_work(database):
            return
        stop.wait(COUNTER_S)


def _until_postgres_has_work(
    database: Database, stop: threading.Event, look: Callable[[], None]
) -> None:
    options = {"isolation_level": "AUTOCOMMIT"}
    with database.engine.connect().execution_options(**options) as connection:
        connection.execute(text(f"LISTEN {CHANNEL}"))
        driver: Any = connection.connection.driver_connection
        looked = -math.inf
        try:
            while not stop.is_set():
                if time.monotonic() - looked > LOOK_S:
                    looked = time.monotonic()
                    if has_work(database):
                        return
                    look()
                if list(driver.notifies(timeout=LISTENING_S, stop_after=1)):
                    looked = -math.inf
        finally:
            connection.invalidate()  # or it would be handed out while it listens
