"""Actions that write, each as if in a transaction of its own.

SQLite has one writer at a time, and of what a small change takes a third is the commit. So one
thread of the process runs the actions, and those that wait share a transaction, a commit and a sync
to disk, each behind a savepoint. One that fails takes back what it wrote and nothing else. None is
answered before the commit, and where that fails all are told so: even a refusal may rest on what
another one wrote. PostgreSQL has many writers and groups their commits itself: there an action runs
in a thread of its caller.
"""

from __future__ import annotations

import asyncio
import queue
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from contextvars import Context, copy_context
from dataclasses import dataclass, field
from typing import Any, TypeVar

from sqlalchemy import Connection
from sqlalchemy.exc import SQLAlchemyError

from trueup_service.registry.database import Database
from trueup_service.registry.transaction import Transaction, writing

R = TypeVar("R")
LONGEST_S = 0.01  # for which others may join a transaction [s]


class Writer:
    """Runs actions on one database."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self._waiting: queue.SimpleQueue[_Action | None] = queue.SimpleQueue()
        self._thread: threading.Thread | None = None
        self._connection: Connection | None = None
        self._is_ending = False
        self._starting = threading.Lock()

    def run(self, act: Callable[[Transaction], R]) -> R:
        """Returns what the action returns, once that is durable. Raises what it raises, SQLAlchemy
        errors where it could not be committed, and BrokenChain where the log does not tell of all
        that it wrote."""
        if not self._database.is_sqlite:
            with writing(self._database) as tx:
                return act(tx)
        return self._submit(act).result()

    async def run_async(self, act: Callable[[Transaction], R]) -> R:
        """`run` from the event loop, which goes on meanwhile."""
        if not self._database.is_sqlite:
            return await asyncio.to_thread(self.run, act)
        return await asyncio.wrap_future(self._submit(act))

    def close(self) -> None:
        """Ends the thread, once all that waits is done."""
        if self._thread is not None:
            self._waiting.put(None)
            self._thread.join()
            self._thread = None

    def _submit(self, act: Callable[[Transaction], R]) -> Future[R]:
        action = _Action(act, copy_context())
        if self._thread is None:
            self._start()
        self._waiting.put(action)
        return action.done

    def _start(self) -> None:
        with self._starting:
            if self._thread is None:
                self._is_ending = False
                self._thread = threading.Thread(target=self._serve, name="writer", daemon=True)
                self._thread.start()

    def _serve(self) -> None:
        while (action := self._taken()) is not None:
            self._commit_with_others(action)
            if self._is_ending:
                break
        self._disconnect()

    def _taken(self, *, wait: bool = True) -> _Action | None:
        """The next action that nobody has cancelled. None at the end, and where none waits."""
        while wait or not self._waiting.empty():
            action = self._waiting.get()
            if action is None:
                self._is_ending = True
                return None
            if action.done.set_running_or_notify_cancel():
                return action
        return None

    def _connected(self) -> Connection:
        if self._connection is None:
            self._connection = self._database.connect_to_write()
        return self._connection

    def _disconnect(self) -> None:
        if self._connection is not None:
            connection, self._connection = self._connection, None
            connection.close()

    def _commit_with_others(self, action: _Action) -> None:
        """Runs an action and those that wait in one transaction."""
        ran, until = [action], time.monotonic() + LONGEST_S
        try:
            connection = self._connected()
            with self._database.write_on(connection):
                transaction = Transaction(connection)
                more: _Action | None = action
                while more is not None:
                    if not more.succeeds(transaction):
                        transaction = Transaction(connection)  # without what it remembers
                    more = self._taken(wait=False) if time.monotonic() < until else None
                    if more is not None:
                        ran.append(more)
        except BaseException as error:  # noqa: BLE001  (it is raised where it is waited for)
            for one in ran:
                one.done.set_exception(error)
            with suppress(SQLAlchemyError):
                self._disconnect()
        else:
            for one in ran:
                one.succeed()


@dataclass(slots=True)
class _Action:
    act: Callable[[Transaction], Any]
    context: Context
    done: Future[Any] = field(default_factory=Future)
    returned: Any = None
    raised: BaseException | None = None

    def succeeds(self, transaction: Transaction) -> bool:
        """Runs it behind a savepoint, and says whether it raised nothing. Raises what SQLite gives
        up a whole transaction at."""
        execute = transaction.connection.exec_driver_sql
        execute("SAVEPOINT action")
        try:
            self.returned = self.context.run(self.act, transaction)
            transaction.require_logged()
        except BaseException as error:  # noqa: BLE001  (it is raised where it is waited for)
            self.raised = error
            try:
                execute("ROLLBACK TO action")
            except Exception:  # noqa: BLE001  (there is no such savepoint any more)
                raise error from None
        execute("RELEASE action")
        return self.raised is None

    def succeed(self) -> None:
        """Hands over what the action returned or raised."""
        if self.raised is None:
            self.done.set_result(self.returned)
        else:
            self.done.set_exception(self.raised)
