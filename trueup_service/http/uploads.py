"""Receive a request's body into a file of ours, hashed while it streams, all or nothing."""

from __future__ import annotations

import base64
import hashlib
import uuid
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path

from fastapi import Request
from starlette.requests import ClientDisconnect

from trueup_service.errors import BadRequest, DigestMismatch, TooLargeUpload


@dataclass(frozen=True, slots=True)
class Received:
    """A file that is ours until the request ends, its SHA-256 and its size."""

    path: Path
    digest: str
    size_bytes: int


@asynccontextmanager
async def received(request: Request, spool: Path, limit_bytes: int) -> AsyncIterator[Received]:
    """The body as a file in `spool`, removed at the end. Raises TooLargeUpload, DigestMismatch, BadRequest."""
    _allow(request.headers.get("content-length"), limit_bytes)
    path = spool / uuid.uuid4().hex
    try:
        digest, size = await _receive(request, path, limit_bytes)
        _require_digest(request.headers.get("content-digest"), digest)
        yield Received(path, digest, size)
    finally:
        path.unlink(missing_ok=True)


async def _receive(request: Request, path: Path, limit_bytes: int) -> tuple[str, int]:
    hashed, size = hashlib.sha256(), 0
    with path.open("xb", buffering=0) as file:
        try:
            async for part in request.stream():
                size += len(part)
                _allow(str(size), limit_bytes)
                hashed.update(part)
                file.write(part)
        except ClientDisconnect as error:
            raise BadRequest("the connection closed before the body was whole", hint="Send it again.") from error
    return hashed.hexdigest(), size


def _allow(size: str | None, limit_bytes: int) -> None:
    if size is not None and size.isdigit() and int(size) > limit_bytes:
        raise TooLargeUpload(f"the upload has more than {limit_bytes} bytes", limit_bytes=limit_bytes)


def _require_digest(header: str | None, digest: str) -> None:
    """Hold the body against RFC 9530's `Content-Digest: sha-256=:base64:`; other algorithms are not ours to judge."""
    for item in (header or "").split(","):
        name, _, value = item.strip().partition("=")
        if name.lower() == "sha-256" and value.strip(":") != base64.b64encode(bytes.fromhex(digest)).decode():
            raise DigestMismatch("the body is not what Content-Digest says", found=digest)
