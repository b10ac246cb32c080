"""The stream by which open pages hear what others do (server-sent events)."""

from __future__ import annotations

from collections.abc import AsyncIterator, Sequence
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
from trueup_service.wiring import Parts

router = guarded("", ["pages"], documented=False)
HEADERS = {"Cache-Control": "no-store", "X-Accel-Buffering": "no"}
RETRY_MS = 3000  # after which a browser asks again
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
    async for size, entries in feed.listen(after):
        seen = await run_in_threadpool(_seen, parts, principal, plant, entries)
        for e in seen:
            data = {"plant": e.plant, "kind": e.kind, "words": in_words(e.kind, e.plant, e.facts)}
            yield _event(e.sequence, "alarm" if e.kind == ALARM else "entry", orjson.dumps(data))
        yield _event(size, "at", b"{}")


def _event(sequence: int, kind: str, data: bytes) -> bytes:
    return b"id: %d\nevent: %s\ndata: %s\n\n" % (sequence, kind.encode(), data)


def _seen(
    parts: Parts, principal: Principal, plant: str | None, entries: Sequence[AuditEntry]
) -> list[AuditEntry]:
    """The entries that a caller sees: of its plants, and of no plant where it sees all projects."""
    asked = [e for e in entries if plant is None or e.plant == plant]
    if principal.everywhere:
        return asked
    plants = {e.plant for e in asked if e.plant is not None}
    visible = {p for p in plants if is_visible(parts.database, principal, p)}
    return [e for e in asked if e.plant in visible]
