"""Responses to "what serves?", cheap enough for a fleet to poll, and never older than the last
acknowledged move.

On SQLite a response is remembered, and SQLite's change counter is read before it is used (`PRAGMA
data_version`, a few microseconds, no table touched). Any commit by any connection of any process
moves the counter, and then the row is read again. A move is acknowledged after its commit, so
whoever knows of a move finds the counter moved. On PostgreSQL the row is read each time.
"""

from __future__ import annotations

import asyncio
from dataclasses import asdict, dataclass
from typing import Any

import orjson
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response

from trueup_service.actions import find
from trueup_service.actions.move_pointer import position_document
from trueup_service.registry.database import Database
from trueup_service.registry.transaction import ReadTransaction

Asked = tuple[str, str | None]  # a plant, and one of its channels or None for its own pointer


@dataclass(frozen=True, slots=True)
class ServingAnswer:
    """The response with what serves, the one that says that it is still that of the entity tag, and
    the tag. They are made once, and given to everybody."""

    etag: str
    whole: Response
    unchanged: Response

    @staticmethod
    def of(position: dict[str, Any], generation: int) -> ServingAnswer:
        """The responses with a position of a pointer or channel."""
        etag = f'"{generation}"'
        headers = {"ETag": etag, "Cache-Control": "no-cache"}
        whole = Response(orjson.dumps(position), media_type="application/json", headers=headers)
        return ServingAnswer(etag, whole, Response(status_code=304, headers=headers))


def matches(etag: str, asked: str) -> bool:
    """Whether an If-None-Match header has this tag, in a list, as a weak one or as `*` (RFC 9110,
    section 13.1.2)."""
    return (
        asked == etag
        or asked.strip() == "*"
        or etag in (tag.strip().removeprefix("W/") for tag in asked.split(","))
    )


class ServingAnswers:
    """The responses of one server, used on its event loop only. Once `closing` is set nobody waits
    any more."""

    closing = False

    def __init__(self, database: Database, watch_interval_s: float) -> None:
        self._database = database
        self._interval_s = watch_interval_s
        self._kept: dict[Asked, ServingAnswer] = {}
        self._counter = database.change_counter()
        self._moved = asyncio.Event()

    async def now(self, asked: Asked) -> ServingAnswer:
        """What serves now. Raises NotFound."""
        if self._counter is None:
            return await run_in_threadpool(self._read, asked)
        if self._counter.moved():
            self._kept.clear()
        answer = self._kept.get(asked)
        if answer is None:
            answer = self._kept[asked] = self._read(asked)
        return answer

    async def after(self, asked: Asked, etag: str, wait_s: float) -> ServingAnswer:
        """What serves once its tag differs from `etag`, or after `wait_s` [s]. Raises NotFound."""
        clock = asyncio.get_running_loop().time
        deadline = clock() + wait_s
        while (
            matches((answer := await self.now(asked)).etag, etag)
            and (left := deadline - clock()) > 0
            and not self.closing
        ):
            await self._next_look(min(left, self._interval_s))
        return answer

    def wake(self) -> None:
        """Let everybody who waits look now, since this process has moved a pointer."""
        self._moved.set()
        self._moved = asyncio.Event()

    async def _next_look(self, seconds: float) -> None:
        try:
            await asyncio.wait_for(self._moved.wait(), seconds)
        except TimeoutError:
            return

    def _read(self, asked: Asked) -> ServingAnswer:
        plant, channel = asked
        with self._database.glance() as connection:
            tx = ReadTransaction(connection)
            if channel is None:
                move = find.serving(tx, plant)
                position, generation = position_document(move), move.generation
            else:
                at = find.channel_move(tx, plant, channel)
                position, generation = asdict(at), at.generation
        return ServingAnswer.of(position, generation)
