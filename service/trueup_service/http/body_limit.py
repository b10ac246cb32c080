"""Limits on request bodies that are held in memory, for each body and for all together. Uploads
stream to disk, and have limits of their own.

A request without a token may send a form to sign in, and takes no room from others. One token may
hold at most a share of the room.
"""

from __future__ import annotations

import gc
import re
from collections import Counter

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from trueup_service.authentication import Principal
from trueup_service.errors import MemoryFull, TooLargeUpload

LIMIT_BYTES = 4 << 20
FORM_BYTES = 16 << 10  # of a body that needs no token
SHARE = 0.5  # of the room that the bodies of one token may take
UPLOADS = re.compile(r"/v1/(plants/[^/]+/(episodes|uploads/[^/]+)|blobs/[^/]+|drafts)")


class BodyLimit:
    """ASGI middleware. Reading a longer body raises TooLargeUpload, and reading one for which other
    requests leave no room raises MemoryFull."""

    def __init__(self, app: ASGIApp, room_bytes: int) -> None:
        self._app, self._room = app, room_bytes
        self._passed, self._limit = 0, room_bytes
        self._held = Counter[str]()  # bytes of each token's bodies

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http" or UPLOADS.fullmatch(scope["path"]):
            await self._app(scope, receive, send)
            return
        read, taken, whose = 0, 0, ""

        async def counted() -> Message:
            nonlocal read, taken, whose
            message = await receive()
            read += len(message.get("body", b""))
            principal: Principal | None = scope.get("principal")
            limit = FORM_BYTES if principal is None else LIMIT_BYTES
            if read > limit:
                raise TooLargeUpload(
                    f"the body has more than {limit} bytes",
                    hint="Send less at once; long recordings and arrays have routes of their own.",
                    limit_bytes=limit,
                )
            if principal is not None:
                whose, more = principal.token, read - taken
                taken = read
                self._take(whose, more)
            return message

        try:
            await self._app(scope, counted, send)
        finally:
            self._give_back(whose, taken)
            self._passed += read
            # A refused body hangs on its error, in a reference cycle that is collected late.
            if self._passed > self._limit:
                self._passed = 0
                gc.collect()

    def _take(self, token: str, size: int) -> None:
        self._room -= size
        self._held[token] += size
        if self._room < 0:
            raise MemoryFull("other requests leave no room for this one's body")
        if self._held[token] > max(SHARE * self._limit, LIMIT_BYTES):
            raise MemoryFull("other requests with this token leave no room for this one's body")

    def _give_back(self, token: str, size: int) -> None:
        self._room += size
        self._held[token] -= size
        if not self._held[token]:
            del self._held[token]
