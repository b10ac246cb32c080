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
from typing import Annotated

import orjson
from fastapi import Depends, Query, Request, Response
from starlette.concurrency import run_in_threadpool
from starlette.requests import ClientDisconnect

from trueup.episode.role import Role
from trueup.recording.described import Described
from trueup_service.actions.ingestion import ReceivedFile, ingest
from trueup_service.actor_context import ActorContext
from trueup_service.errors import BadRequest, DigestMismatch, TooLargeUpload
from trueup_service.http.dependencies import created, inspector_of
from trueup_service.http.schemas.episodes import Episode
from trueup_service.inspection import Inspected, PlantContext, mcap_path
from trueup_service.partial_uploads import write_all
from trueup_service.wiring import Parts

# what a client sends that does not know what it sends
UNTYPED = (
    "",
    "application/octet-stream",
    "application/x-www-form-urlencoded",
    "binary/octet-stream",
)
PART_BYTES, SYNC_BYTES = 1 << 20, 4 << 20
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


def described(
    request: Request,
    role: Annotated[
        Role | None, Query(description="What it was recorded for, where the file does not say it")
    ] = None,
    conditions: Annotated[
        str | None,
        Query(max_length=4096, description="The collection conditions, a JSON object of text"),
    ] = None,
    mapping: Annotated[
        str | None,
        Query(max_length=65536, description="Which signals are meant: a mapping, as JSON"),
    ] = None,
    part: Annotated[
        str | None,
        Query(max_length=255, description="Which of several runs in the file, by name or number"),
    ] = None,
    name: Annotated[str | None, Query(max_length=255, description="The file's name")] = None,
) -> Described:
    """What is said of a recording beside its bytes. Raises BadRequest."""
    media_type = (request.headers.get("content-type") or "").split(";")[0].strip().lower()
    return Described(
        name,
        None if media_type in UNTYPED else media_type,
        role,
        _conditions(conditions),
        mapping,
        part,
    )


def _conditions(text: str | None) -> dict[str, str]:
    if text is None:
        return {}
    try:
        values = orjson.loads(text)
    except orjson.JSONDecodeError as error:
        raise BadRequest(f"conditions is not JSON: {error}", field="conditions") from error
    if (
        not isinstance(values, dict)
        or not all(isinstance(v, str) for v in values.values())
        or "role" in values
    ):
        raise BadRequest(
            "conditions is an object of text; the role stands beside it", field="conditions"
        )
    return values


RecordingDescription = Annotated[Described, Depends(described)]


@asynccontextmanager
async def inspected_episode(
    request: Request, file: ReceivedFile, against: PlantContext, described: Described
) -> AsyncIterator[tuple[ReceivedFile, Inspected]]:
    """The episode that a received file is, or that is made of it, which is removed at the end, and
    what it holds. Raises BadEpisode, InspectionFailed."""
    made = mcap_path(file.path)
    try:
        inspected = await inspector_of(request).inspect(file.path, against, described=described)
        if made.exists():
            file = ReceivedFile(made, inspected.digest, made.stat().st_size)
        yield file, inspected
    finally:
        made.unlink(missing_ok=True)


def ingest_response(
    parts: Parts,
    context: ActorContext,
    plant: str,
    key: str | None,
    file: ReceivedFile,
    inspected: Inspected,
    name: str | None = None,
) -> Response:
    """Make a received file, which has a name, an episode, and respond with it."""
    return created(ingest(parts, context, plant, key, file, inspected, name), Episode)
