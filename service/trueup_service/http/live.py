"""What is added to the log, passed on to every page that is open.

One look at the log a second serves all pages of a process, and there is none while no page listens.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import AsyncIterator

from starlette.concurrency import run_in_threadpool

from trueup.ledger.audit import AuditEntry
from trueup_service.registry.database import Database
from trueup_service.registry.transaction import reading

LOOK_S = 1.0  # between looks at the log
MOST = 100  # entries of one look; older ones are left out, for a page is read anew anyway
WAITING = 20  # looks that a slow reader may be behind
QUIET_S = 15.0  # after which a page is told that nothing happened, so that no proxy ends the stream
LONGEST_S = 600.0  # of a stream; the next one is authorised anew
log = logging.getLogger("trueup.http")


class LiveFeed:
    """The new entries of the log, for whoever listens. It is used on one event loop only; once it
    is closed, every stream ends."""

    def __init__(self, database: Database, interval_s: float = LOOK_S) -> None:
        self._database, self._interval_s = database, interval_s
        self._listeners: set[asyncio.Queue[list[AuditEntry] | None]] = set()
        self._looking: asyncio.Task[None] | None = None
        self._closed = False

    async def listen(self, after: int | None) -> AsyncIterator[tuple[int, list[AuditEntry]]]:
        """Yields the log's size and its new entries: those after one at once, nothing where it is
        None, then each as it comes, and no entries after QUIET_S without any."""
        size, entries = await run_in_threadpool(self._since, after)
        queue: asyncio.Queue[list[AuditEntry] | None] = asyncio.Queue(WAITING)
        self._listeners.add(queue)
        if self._looking is None or self._looking.done():
            self._looking = asyncio.create_task(self._look(size))
        clock = asyncio.get_running_loop().time
        end = clock() + LONGEST_S
        try:
            yield size, entries
            while not self._closed and (left := end - clock()) > 0.0:
                try:
                    more = await asyncio.wait_for(queue.get(), min(QUIET_S, left))
                except TimeoutError:
                    more = []
                if more is None:
                    return
                size = max([size, *(e.sequence for e in more)])
                yield size, [e for e in more if e.sequence > size - MOST]
        finally:
            self._listeners.discard(queue)

    def close(self) -> None:
        """End every stream."""
        self._closed = True
        for queue in self._listeners:
            if queue.full():
                queue.get_nowait()
            queue.put_nowait(None)

    async def _look(self, size: int) -> None:
        """Passes new entries on as long as somebody listens."""
        while self._listeners and not self._closed:
            await asyncio.sleep(self._interval_s)
            try:
                size, entries = await run_in_threadpool(self._since, size)
            except Exception:
                log.exception("the log could not be read for the open pages; trying again")
                continue
            if entries:
                for queue in self._listeners:
                    if not queue.full():  # a slow reader misses some, and reads its page anew
                        queue.put_nowait(entries)

    def _since(self, after: int | None) -> tuple[int, list[AuditEntry]]:
        """The log's size, and its entries after one, the newest MOST of them."""
        with reading(self._database) as tx:
            size = tx.log.size()
            if after is None or after >= size:
                return size, []
            return size, tx.log.entries(max(after, size - MOST), MOST)
