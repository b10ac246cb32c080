"""A pool of clients for an event loop, each in a thread of its own while it asks."""

from __future__ import annotations

import asyncio
import contextlib
import threading
from collections.abc import AsyncIterator, Callable, Generator, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Concatenate, ParamSpec, TypeVar

from trueup_client.client import Client
from trueup_client.problem import Unreachable

P = ParamSpec("P")
T = TypeVar("T")
END: Any = object()
CLOSED = "the client was closed"


class Pool:
    """At most `at_once` clients that ask at the same time; one more waits for its turn.

    A call that is cancelled is broken off. Whether the service did what it asked for is then
    unknown: ask, or repeat it with its key.
    """

    def __init__(self, make: Callable[[], Client], at_once: int) -> None:
        self._make, self._free, self._busy = make, list[Client](), set[Client]()
        self._threads = ThreadPoolExecutor(at_once, thread_name_prefix="trueup")
        self._closed = False

    async def run(
        self, method: Callable[Concatenate[Client, P], T], *arguments: P.args, **named: P.kwargs
    ) -> T:
        """Calls a method of a client in a thread, and returns what it returns."""
        turn = _Turn()

        def ask() -> T:
            client = self._take()
            try:
                turn.begin(client)
                return method(client, *arguments, **named)
            finally:
                self._give_back(client)

        try:
            return await self._threaded(ask)
        except asyncio.CancelledError:
            turn.abort()
            raise

    async def each(
        self,
        method: Callable[Concatenate[Client, P], Iterator[T]],
        *arguments: P.args,
        **named: P.kwargs,
    ) -> AsyncIterator[T]:
        """Yields what a method of a client yields, each item asked for once the last was taken."""
        client, asks = self._take(), threading.Lock()
        items = method(client, *arguments, **named)

        def ask() -> T:
            with asks:
                return next(items, END)

        try:
            while (item := await self._threaded(ask)) is not END:
                yield item
        finally:
            if asks.acquire(blocking=False):
                asks.release()
                self._end(client, items, asks)
            else:  # cancelled while its thread asks
                client.abort()
                threading.Thread(target=self._end, args=(client, items, asks), daemon=True).start()

    async def close(self) -> None:
        """Closes every connection. Calls that run or wait for their turn end with Unreachable."""
        self._closed = True
        for client in [*self._busy]:
            client.abort()
        await asyncio.to_thread(self._threads.shutdown, cancel_futures=True)
        for client in [*self._free, *self._busy]:
            client.close()

    async def _threaded(self, function: Callable[[], T]) -> T:
        try:
            future = self._threads.submit(function)
        except RuntimeError as error:
            raise Unreachable(CLOSED) from error
        try:
            return await asyncio.wrap_future(future)
        except asyncio.CancelledError:
            task = asyncio.current_task()
            if self._closed and task is not None and not task.cancelling():
                raise Unreachable(CLOSED) from None
            raise

    def _end(self, client: Client, items: Iterator[T], asks: threading.Lock) -> None:
        """Closes an iterator once no thread reads it, then frees its client for other calls."""
        with asks:
            if isinstance(items, Generator):
                items.close()
        self._give_back(client)

    def _take(self) -> Client:
        client = None
        with contextlib.suppress(IndexError):
            client = self._free.pop()  # whole under the interpreter's lock, as all of these are
        client = client or self._make()
        self._busy.add(client)
        if self._closed:  # while it was on its way here
            client.abort()
        return client

    def _give_back(self, client: Client) -> None:
        self._busy.discard(client)
        if self._closed or client.aborted:
            client.close()
        else:
            self._free.append(client)


class Pooled:
    """Calls that ask through a pool."""

    _pool: Pool


class _Turn:
    """A call's client, once a thread took one for it, and whether the call is still wanted."""

    def __init__(self) -> None:
        self._client: Client | None = None
        self._wanted = True

    def begin(self, client: Client) -> None:
        self._client = client
        if not self._wanted:
            client.abort()

    def abort(self) -> None:
        self._wanted = False
        if self._client is not None:
            self._client.abort()
