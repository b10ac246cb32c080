"""The stream by which open pages hear what others do (server-sent events)."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import aclosing
from typing import Annotated

import orjson
from fastapi import Header, Query, Request
from starlette.concurrency import run_in_threadpool
from starlette.responses import StreamingResponse

from trueup.ledger.audit import AuditEntry
from trueup_pages.live import ALARM, in_words
from trueup_service.authentication import Principal
from trueup_service.http.dependencies import RequestParts
from trueup_service.http.guard import CurrentPrincipal, guarded, is_visible
from trueup_service.http.live import LiveFeed
from trueup_service.registry.transaction import reading
from trueup_service.wiring import Parts

router = guarded("", ["pages"], documented=False)
HEADERS = {"Cache-Control": "no-store", "X-Accel-Buffering": "no"}
RETRY_MS = 3000  # after which a browser asks again
MOST = 100  # entries told at once, and alarms beside them; a page is read anew, whatever it missed
AfterEntry = Annotated[int | None, Query(ge=0, le=2**62, description="the last entry seen")]


@router.get("/live")
async def live(
    request: Request,
    parts: RequestParts,
    principal: CurrentPrincipal,
    plant: Annotated[str | None, Query(max_length=63)] = None,
    after: AfterEntry = None,
    last_event_id: Annotated[str | None, Header()] = None,
) -> StreamingResponse:
    """New entries of the log on plants that the caller sees, or on one: an `alarm` or an `entry`
    each, with what happened in words."""
    if last_event_id is not None and last_event_id.isdecimal():
        after = int(last_event_id[:18])
    stream = _events(request.app.state.live, parts, principal, plant, after)
    return StreamingResponse(stream, media_type="text/event-stream", headers=HEADERS)


async def _events(
    feed: LiveFeed, parts: Parts, principal: Principal, plant: str | None, after: int | None
) -> AsyncIterator[bytes]:
    yield b"retry: %d\n\n" % RETRY_MS
    async with aclosing(feed.sizes()) as sizes:
        async for size in sizes:
            new = (
                []
                if after is None or size <= after
                else await run_in_threadpool(_new, parts, principal, plant, after, size)
            )
            for e in new:
                words = in_words(e.kind, e.plant, e.facts)
                data = {"plant": e.plant, "kind": e.kind, "words": words}
                kind = "alarm" if e.kind == ALARM else "entry"
                yield _event(e.sequence, kind, orjson.dumps(data))
            yield _event(size, "at", b"{}")
            after = size


def _event(sequence: int, kind: str, data: bytes) -> bytes:
    return b"id: %d\nevent: %s\ndata: %s\n\n" % (sequence, kind.encode(), data)


def _new(
    parts: Parts, principal: Principal, plant: str | None, after: int, size: int
) -> list[AuditEntry]:
    """The entries from behind one up to a size that a caller sees, in order: the newest MOST, and
    the newest MOST alarms."""
    if plant is not None and not is_visible(parts.database, principal, plant):
        return []
    of = principal.plant if plant is None else plant
    project = principal.project if of is None else None
    with reading(parts.database) as tx:
        entries = [
            e
            for kind in ("", ALARM)
            for e in tx.log.newest_entries(
                size + 1, MOST, after=after, plant=of, project=project, kind=kind
            )
        ]
    return sorted({e.sequence: e for e in entries}.values(), key=lambda e: e.sequence)
