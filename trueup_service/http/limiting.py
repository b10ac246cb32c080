"""Bodies that are held in memory have a limit, each and all together; uploads, which stream to disk, have one of their own."""

from __future__ import annotations

import gc
import re

from trueup_service.errors import MemoryFull, TooLargeUpload
from trueup_service.http.observing import App, Message, Receive, Scope, Send

LIMIT_BYTES = 4 << 20
UPLOADS = re.compile(r"/v1/(plants/[^/]+/(episodes|uploads/[^/]+)|blobs/[^/]+)")


class Limiting:
    """ASGI middleware: a longer body ends in TooLargeUpload where the route reads it, one that others leave no room for in MemoryFull."""

    def __init__(self, app: App, room_bytes: int) -> None:
        self._app, self._room = app, room_bytes
        self._passed, self._limit = 0, room_bytes

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http" or UPLOADS.fullmatch(scope["path"]):
            await self._app(scope, receive, send)
            return
        read = 0

        async def counted() -> Message:
            nonlocal read
            message = await receive()
            came = len(message.get("body", b""))
            read += came
            self._room -= came
            if read > LIMIT_BYTES:
                told = f"the body has more than {LIMIT_BYTES} bytes"
                raise TooLargeUpload(
                    told, hint="Send less at once; long recordings and arrays have routes of their own.", limit_bytes=LIMIT_BYTES
                )
            if self._room < 0:
                raise MemoryFull("other requests leave no room for this one's body")
            return message

        try:
            await self._app(scope, counted, send)
        finally:
            self._room += read
            self._passed += read
            if self._passed > self._limit:  # a refused body hangs on its error, in a circle that the collector is slow to see
                self._passed = 0
                gc.collect()
