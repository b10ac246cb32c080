"""How long the log is, told to every page that is open.

One look at the log a second serves all pages of a process, and there is none while no page listens.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import AsyncGenerator

from starlette.concurrency import run_in_threadpool

from trueup_service.registry.database import Database
from trueup_service.registry.transaction import reading

LOOK_S = 1.0  # between looks at the log
QUIET_S = 15.0  # after which a page is told that nothing happened, so that no proxy ends the stream
LONGEST_S = 600.0  # of a stream; the next one is authorised anew
log = logging.getLogger("trueup.http")


class LiveFeed:
    """The log's size, for whoever listens. It is used on one event loop only; once it is closed,
    every stream ends."""

    def __init__(self, database: Database, interval_s: float = LOOK_S) -> None:
        self._database, self._interval_s = database, interval_s
        self._size, self._changed = 0, asyncio.Event()
        self._listeners = 0
        self._looking: asyncio.Task[None] | None = None
        self._closed = False

    async def sizes(self) -> AsyncGenerator[int, None]:
        """Yields the log's size at once, then whenever it has changed, and after QUIET_S without a
        change."""
        clock = asyncio.get_running_loop().time
        end = clock() + LONGEST_S
        self._listeners += 1
        try:
            await self._read()
            if self._looking is None or self._looking.done():
                self._looking = asyncio.create_task(self._look())
            while not self._closed and clock() < end:
                size = self._size
                yield size
                if size == self._size and not self._closed:
                    await self._next_change(min(QUIET_S, end - clock()))
        finally:
            self._listeners -= 1
            if not self._listeners and self._looking is not None:
                self._looking.cancel()
                self._looking = None

    def close(self) -> None:
        """End every stream."""
        self._closed = True
        if self._looking is not None:
            self._looking.cancel()
        self._wake()

    async def _look(self) -> None:
        while True:
            await asyncio.sleep(self._interval_s)
            try:
                await self._read()
            except Exception:
                log.exception("the log could not be read for the open pages; trying again")

    async def _read(self) -> None:
        size = await run_in_threadpool(self._size_of_log)
        if size > self._size:  # of two looks at once the older one may come last
            self._size = size
            self._wake()

    def _size_of_log(self) -> int:
        with reading(self._database) as tx:
            return tx.log.size()

    def _wake(self) -> None:
        self._changed.set()
        self._changed = asyncio.Event()

    async def _next_change(self, seconds: float) -> None:
        try:
            await asyncio.wait_for(self._changed.wait(), max(seconds, 0.0))
        except TimeoutError:
            return
