"""Receive a request's body as a file on the spool, hashed while it streams, all or nothing."""

from __future__ import annotations

import asyncio
import base64
import hashlib
import os
import uuid
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from io import FileIO
from pathlib import Path

from fastapi import Request, Response
from starlette.concurrency import run_in_threadpool
from starlette.requests import ClientDisconnect

from trueup_service.actions.ingestion import ReceivedFile, ingest
from trueup_service.actor_context import ActorContext
from trueup_service.errors import BadRequest, DigestMismatch, TooLargeUpload
from trueup_service.http.dependencies import created
from trueup_service.http.schemas.episodes import Episode
from trueup_service.inspection import Inspected
from trueup_service.partial_uploads import write_all
from trueup_service.wiring import Parts

PART_BYTES, SYNC_BYTES = 256 << 10, 4 << 20
ARRAYS_HINT = "Pack a smaller model, or raise TRUEUP_ARRAYS_LIMIT_BYTES."


@asynccontextmanager
async def received(
    request: Request, spool: Path, limit_bytes: int, hint: str | None = None
) -> AsyncIterator[ReceivedFile]:
    """The body as a file in `spool`, which is removed at the end. Raises BadRequest,
    DigestMismatch, and TooLargeUpload with this hint or its own."""
    declared = request.headers.get("content-length", "")
    allow(int(declared) if declared.isdigit() else 0, limit_bytes, hint)
    path = spool / uuid.uuid4().hex
    try:
        digest, size = await _receive(request, path, limit_bytes, hint)
        _require_digest(request.headers.get("content-digest"), digest)
        yield ReceivedFile(path, digest, size)
    finally:
        path.unlink(missing_ok=True)


async def _receive(
    request: Request, path: Path, limit_bytes: int, hint: str | None
) -> tuple[str, int]:
    """Write the body to a file. Returns its digest and size. While one part is hashed and written
    in a thread, the next one is received."""
    gathered, under_way, size = bytearray(), None, 0
    with path.open("xb", buffering=0) as file:
        sink = _Sink(file)
        try:
            async for part in request.stream():
                gathered += part
                size += len(part)
                allow(size, limit_bytes, hint)
                if len(gathered) >= PART_BYTES:
                    if under_way is not None:
                        await under_way
                    under_way = asyncio.create_task(run_in_threadpool(sink.take, gathered))
                    gathered = bytearray()
        except ClientDisconnect as error:
            raise BadRequest(
                "the connection closed before the body was whole", hint="Send it again."
            ) from error
        finally:
            if under_way is not None:
                await under_way
        sink.take(gathered)
    return sink.hashed.hexdigest(), size


class _Sink:
    """Hashes and writes parts, and syncs now and then, to leave little to sync at the end."""

    def __init__(self, file: FileIO) -> None:
        self.hashed = hashlib.sha256()
        self._file, self._unsynced = file, 0

    def take(self, part: bytearray) -> None:
        self.hashed.update(part)
        write_all(self._file, part)
        self._unsynced += len(part)
        if self._unsynced >= SYNC_BYTES:
            os.fdatasync(self._file.fileno())
            self._unsynced = 0


def allow(size: int, limit_bytes: int, hint: str | None = None) -> None:
    """Raises TooLargeUpload where an upload has more bytes than the limit."""
    if size > limit_bytes:
        raise TooLargeUpload(
            f"the upload has more than {limit_bytes} bytes", hint=hint, limit_bytes=limit_bytes
        )


def _require_digest(header: str | None, digest: str) -> None:
    """Raises DigestMismatch where `Content-Digest: sha-256=:base64:` (RFC 9530) names another
    digest. Other algorithms are ignored."""
    for item in (header or "").split(","):
        name, _, value = item.strip().partition("=")
        if (
            name.lower() == "sha-256"
            and value.strip(":") != base64.b64encode(bytes.fromhex(digest)).decode()
        ):
            raise DigestMismatch("the body is not what Content-Digest says", found=digest)


def ingest_response(
    parts: Parts,
    context: ActorContext,
    plant: str,
    key: str | None,
    file: ReceivedFile,
    inspected: Inspected,
) -> Response:
    """Make a received file an episode, and respond with it."""
    return created(ingest(parts, context, plant, key, file, inspected), Episode)
