"""Remove bytes that no row names: what uploads left that never ended.

What a row names is never touched, and rows are never removed. An upload makes its bytes durable before its row; so bytes are only left over
once they are older than any upload takes, and an upload that finds its bytes there already makes them young again.
"""

from __future__ import annotations

from collections.abc import Callable

from trueup_service.kept import unnamed
from trueup_service.partial_uploads import PartialUploads
from trueup_service.registry.store import Reader
from trueup_service.wiring import Parts

Told = Callable[[float, str], None]


def remove_leftovers(parts: Parts, older_than_s: float, *, dry_run: bool, told: Told) -> dict[str, int]:
    """How many blobs and files of uploads were removed, or would be, and how many bytes."""
    told(0.0, "reading what is named")
    found = unnamed(parts)
    blobs, size = 0, 0
    for count, digest in enumerate(found, 1):
        told(count / len(found), f"blob {digest[:12]}")
        gone = parts.blobs.remove(digest, older_than_s, dry_run=dry_run)
        if gone is not None and not dry_run and _is_named(parts, digest):
            parts.blobs.bring_back(digest)  # an upload of the same bytes came in between
            gone = None
        parts.blobs.forget()
        blobs, size = blobs + (gone is not None), size + (gone or 0)
    files, more = PartialUploads(parts.settings.data_dir).remove_old(older_than_s, dry_run=dry_run)
    return {"blobs": blobs, "files": files, "bytes": size + more}


def _is_named(parts: Parts, digest: str) -> bool:
    with parts.database.read() as connection:
        return Reader(connection).names(digest)
