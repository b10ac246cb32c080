"""Connections of the server: no more than it has room for, and none that keeps it waiting.

- A request's head arrives whole within `header_limit_s` of its first byte, or of the connection,
  and within HEAD_BYTES.
- A connection without a request ends after `keep_alive_s`, and so does one whose request was
  answered before all of it had come.
- A body that is waited for, and an answer that is taken, move by LEAST_BYTES_S over each
  `silence_limit_s`. A request that the service itself keeps waiting, such as a long poll, is no
  silence.
- Descriptors are kept back for database, blobs, spool and checkpoint. Where the others are taken, a
  new connection takes the place of the one that has been without a request for longest; where every
  one has a request, the new one is answered 503.

Source: RFC 9110, section 15.5.9 (408), and RFC 6585, section 5 (431).
"""

from __future__ import annotations

import asyncio
import json
import os
import resource
from collections.abc import Iterable
from dataclasses import dataclass, field
from http import HTTPStatus
from typing import Any

from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol

HEAD_BYTES = 1 << 16  # of a request's line and headers; of trailers, too
LEAST_BYTES_S = 100  # a slow radio link is faster than this
KEPT_SHARE = 4  # at least one descriptor in so many is kept for the service itself
OF_A_DATABASE_CONNECTION = 3  # files: database, write-ahead log, its index
OF_THREADS = 48  # files that requests under way have open: blobs, spool, folders that are synced
LEAST_CONNECTIONS = 8


@dataclass(frozen=True, slots=True)
class Limits:
    """How long a client may keep the server waiting [s], and how many connections it holds."""

    header_s: float
    keep_alive_s: float
    silence_s: float
    connections: int


def room_for_connections(database_pool: int) -> int:
    """How many connections the limit on open files leaves room for, besides the files that the
    service opens itself."""
    soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    own = len(os.listdir("/dev/fd")) + OF_A_DATABASE_CONNECTION * database_pool + OF_THREADS
    return max(LEAST_CONNECTIONS, soft - max(own, soft // KEPT_SHARE))


@dataclass(slots=True)
class Door:
    """Admits and ends connections. Those without a request wait here, the one that has waited
    longest first."""

    limits: Limits
    waiting: dict[HeldConnection, None] = field(default_factory=dict)

    def protocol(self, **options: Any) -> HeldConnection:
        """A new connection. uvicorn calls this."""
        return HeldConnection(self, **options)

    def admit(self, held: int) -> bool:
        """Whether there is room for one more connection, where needed by ending one that waits."""
        if held <= self.limits.connections:
            return True
        longest = next((c for c in self.waiting if not c.transport.is_closing()), None)
        if longest is not None:
            longest.give_way()
        return longest is not None

    def sweep(self, held: Iterable[Any], now: float) -> None:
        """End the connections that have kept the server waiting for too long."""
        for connection in list(held):
            connection.require_progress(now)


class HeldConnection(HttpToolsProtocol):
    """A connection of uvicorn with a clock for each thing that it waits for."""

    def __init__(self, door: Door, **options: Any) -> None:
        super().__init__(**options)
        self._door = door
        self._head_since: float | None = None  # when the head that is being received began
        self._idle_since = 0.0
        self._stray = 0  # bytes since the last head or part of a body
        self._received, self._reading, self._writing = 0, _Clock(), _Clock()

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Admit the connection, or respond 503."""
        super().connection_made(transport)
        self._head_since = self._idle_since = self.loop.time()
        if self._door.admit(len(self.connections)):
            self._door.waiting[self] = None
        else:
            self._refuse(
                HTTPStatus.SERVICE_UNAVAILABLE,
                "busy",
                "every connection is taken",
                "Try again in a moment.",
            )

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget the connection."""
        self._door.waiting.pop(self, None)
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Receive bytes, and refuse more of them than a request's head may have."""
        self._received += len(data)
        self._stray += len(data)
        super().data_received(data)
        if self._stray > HEAD_BYTES and not self.transport.is_closing():
            detail = f"the request's head has more than {HEAD_BYTES} bytes"
            self._refuse(
                HTTPStatus.REQUEST_HEADER_FIELDS_TOO_LARGE,
                "head-too-large",
                detail,
                "Send less in it, and the rest as a body.",
            )

    def on_message_begin(self) -> None:
        """A head begins: start its clock, unless it runs since the connection was made."""
        self._head_since = self._head_since or self.loop.time()
        super().on_message_begin()

    def on_headers_complete(self) -> None:
        """A head is complete: the request is under way."""
        self._stray, self._head_since = 0, None
        self._door.waiting.pop(self, None)
        super().on_headers_complete()

    def on_body(self, body: bytes) -> None:
        """Receive a part of a body."""
        self._stray = 0
        super().on_body(body)

    def on_response_complete(self) -> None:
        """A request is answered: let the connection wait for the next one, unless that is here
        already."""
        super().on_response_complete()
        self._idle_since = self.loop.time()
        if not self._is_answering:
            self._door.waiting[self] = None

    def send_400_response(self, msg: str) -> None:
        """Refuse what is not HTTP with a problem document."""
        self._refuse(
            HTTPStatus.BAD_REQUEST,
            "bad-request",
            msg,
            "Speak HTTP/1.1, without control characters in a header.",
        )

    def give_way(self) -> None:
        """End the connection to make room for another one."""
        self.transport.abort()

    def require_progress(self, now: float) -> None:
        """End the connection where it has kept the server waiting for too long."""
        limits = self._door.limits
        self._require_taken(now)
        if self.transport.is_closing():
            return
        if self._head_since is not None:
            if now - self._head_since > limits.header_s:
                self._time_out("the request's head did not come in time")
        elif not self._is_answering:
            if now - self._idle_since > limits.keep_alive_s:
                self.transport.close()
        elif not self._is_body_wanted:
            self._reading.stop()
        elif self._reading.is_slow(now, self._received, limits.silence_s):
            self._time_out(f"the request's body came with less than {LEAST_BYTES_S} bytes a second")

    def _require_taken(self, now: float) -> None:
        """End the connection where the client does not take the response that is sent to it."""
        left = self.transport.get_write_buffer_size()
        if not self.flow.write_paused and not (left and self.transport.is_closing()):
            self._writing.stop()
        elif self._writing.is_slow(now, -left, self._door.limits.silence_s):
            self.transport.abort()

    def resume_writing(self) -> None:
        """The client has taken what was written: restart the clock for the next part."""
        self._writing.stop()
        super().resume_writing()

    @property
    def _is_answering(self) -> bool:
        return self.cycle is not None and not self.cycle.response_complete

    @property
    def _is_body_wanted(self) -> bool:
        return (
            self.cycle.more_body
            and not self.flow.read_paused
            and not self.cycle.waiting_for_100_continue
        )

    def _time_out(self, detail: str) -> None:
        if self._received == 0 or (self._is_answering and self.cycle.response_started):
            self.transport.close()
        else:
            self._refuse(
                HTTPStatus.REQUEST_TIMEOUT,
                "request-timeout",
                detail,
                "Send it again, with its Idempotency-Key.",
            )

    def _refuse(self, status: HTTPStatus, code: str, detail: str, hint: str) -> None:
        """Respond with a problem document, and close."""
        self.transport.write(refusal(status, code, detail, hint))
        self.transport.close()


class _Clock:
    """Watches whether a number rises by LEAST_BYTES_S, over one window after the other."""

    def __init__(self) -> None:
        self._began: tuple[float, int] | None = None

    def stop(self) -> None:
        self._began = None

    def is_slow(self, now: float, done: int, window_s: float) -> bool:
        began_at, before = self._began = self._began or (now, done)
        if now - began_at < window_s:
            return False
        self._began = now, done
        return done - before < LEAST_BYTES_S * (now - began_at)


def refusal(status: HTTPStatus, code: str, detail: str, hint: str) -> bytes:
    """A complete HTTP response for a connection that has no request."""
    problem = {
        "type": f"urn:trueup:problem:{code}",
        "title": status.phrase,
        "status": int(status),
        "detail": detail,
    }
    body = json.dumps(
        problem | {"code": code, "hint": hint, "facts": {}, "request_id": None}
    ).encode()
    head = (
        f"HTTP/1.1 {int(status)} {status.phrase}",
        "content-type: application/problem+json",
        f"content-length: {len(body)}",
        "connection: close",
    )
    return "\r\n".join((*head, "", "")).encode() + body
