"""Downloads of blobs, which are never complete where the bytes are not what the digest names.

The bytes are hashed while they stream, and the last part is withheld until the hash agrees. Damage
in a blob that fits into one part is found before the response begins, and raises BlobDamaged. A
longer response breaks off before its announced length or its last chunk.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from itertools import chain

from starlette.responses import StreamingResponse

from trueup_service.registry.blobs import BlobDamaged, Blobs

UNCHANGING = "private, max-age=31536000, immutable"


def send_blob(
    blobs: Blobs,
    digest: str,
    size_bytes: int | None = None,
    media_type: str = "application/octet-stream",
    **headers: str,
) -> StreamingResponse:
    """A response with the bytes of a digest, and with their length where it is known. Raises
    BlobMissing, BlobDamaged."""
    parts = verified_parts(blobs.stream(digest), digest, size_bytes)
    first = next(parts, b"")
    length: Mapping[str, str] = {} if size_bytes is None else {"Content-Length": str(size_bytes)}
    all_headers = {
        "ETag": f'"{digest}"',
        "Cache-Control": UNCHANGING,
        **length,
        **{name.replace("_", "-"): x for name, x in headers.items()},
    }
    return StreamingResponse(chain([first], parts), media_type=media_type, headers=all_headers)


def verified_parts(
    parts: Iterator[bytes], digest: str, size_bytes: int | None = None
) -> Iterator[bytes]:
    """Yields parts of bytes, the last one only if all of them have this digest and this size.
    Raises BlobDamaged."""
    hashed, size, withheld = hashlib.sha256(), 0, b""
    for part in parts:
        size += len(part)
        if size_bytes is not None and size > size_bytes:
            raise BlobDamaged.of(digest)
        if withheld:
            yield withheld
        hashed.update(part)
        withheld = part
    if hashed.hexdigest() != digest or size_bytes not in (None, size):
        raise BlobDamaged.of(digest)
    if withheld:
        yield withheld
