"""Pool: clients for an event loop, each in a thread of its own while it asks."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Concatenate, ParamSpec, TypeVar

from trueup_client.client import Client

P = ParamSpec("P")
T = TypeVar("T")
END: Any = object()


class Pool:
    """At most `at_once` clients that ask at the same time; one more waits for its turn.

    A request that is cancelled is not taken back: it goes on to its end at the service, as any that was sent.
    """

    def __init__(self, make: Callable[[], Client], at_once: int) -> None:
        self._make, self._free, self._busy = make, list[Client](), set[Client]()
        self._threads = ThreadPoolExecutor(at_once, thread_name_prefix="trueup")
        self._closed = False

    async def run(self, method: Callable[Concatenate[Client, P], T], *arguments: P.args, **named: P.kwargs) -> T:
        """What a method of a client gives."""
        return await asyncio.get_running_loop().run_in_executor(self._threads, lambda: self._with_one(method, *arguments, **named))

    async def each(self, method: Callable[Concatenate[Client, P], Iterator[T]], *arguments: P.args, **named: P.kwargs) -> AsyncIterator[T]:
        """What a method of a client gives one after the other, each asked for when the one before was taken."""
        client, asks = self._take(), False
        try:
            found, loop = method(client, *arguments, **named), asyncio.get_running_loop()
            while True:
                asks = True
                item = await loop.run_in_executor(self._threads, next, found, END)
                asks = False
                if item is END:
                    return
                yield item
        finally:
            if asks:  # cancelled while its thread asks, or refused: nobody else may use it
                client.abort()
                self._busy.discard(client)
            else:
                self._give_back(client)

    async def close(self) -> None:
        """Close every connection; whatever still asks ends with Unreachable."""
        self._closed = True
        for client in [*self._busy]:
            client.abort()
        await asyncio.to_thread(self._threads.shutdown, cancel_futures=True)
        for client in self._free:
            client.close()

    def _with_one(self, method: Callable[Concatenate[Client, P], T], *arguments: P.args, **named: P.kwargs) -> T:
        client = self._take()
        try:
            return method(client, *arguments, **named)
        finally:
            self._give_back(client)

    def _take(self) -> Client:
        client = None
        with contextlib.suppress(IndexError):
            client = self._free.pop()  # whole under the interpreter's lock, as all of these are
        client = client or self._make()
        self._busy.add(client)
        return client

    def _give_back(self, client: Client) -> None:
        self._busy.discard(client)
        if self._closed:
            client.close()
        else:
            self._free.append(client)
