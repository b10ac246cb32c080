"""Send kept bytes, and never a whole answer of bytes that are not what their digest names.

They are hashed while they stream, and the last part is withheld until the hash agrees. What fits
into one part is so checked before the answer begins, and refused as BlobDamaged; a longer answer
breaks off, short of its announced length or of its last chunk.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from itertools import chain

from starlette.responses import StreamingResponse

from trueup_service.registry.blobs import BlobDamaged, Blobs

UNCHANGING = "private, max-age=31536000, immutable"


def send_kept(
    blobs: Blobs,
    digest: str,
    size_bytes: int | None = None,
    media_type: str = "application/octet-stream",
    **headers: str,
) -> StreamingResponse:
    """The bytes of a digest, with their length where it is known. Raises BlobMissing,
    BlobDamaged."""
    parts = whole(blobs.stream(digest), digest, size_bytes)
    first = next(parts, b"")
    length: Mapping[str, str] = {} if size_bytes is None else {"Content-Length": str(size_bytes)}
    told = {
        "ETag": f'"{digest}"',
        "Cache-Control": UNCHANGING,
        **length,
        **{name.replace("_", "-"): x for name, x in headers.items()},
    }
    return StreamingResponse(chain([first], parts), media_type=media_type, headers=told)


def whole(parts: Iterator[bytes], digest: str, size_bytes: int | None = None) -> Iterator[bytes]:
    """Parts of bytes, the last one only if all of them have this digest, and this size. Raises
    BlobDamaged."""
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
