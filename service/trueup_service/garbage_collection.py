"""Garbage collection: remove bytes that no row names, which uploads left that never ended.

Bytes that a row names are never removed, and neither are rows. An upload makes its bytes durable
before its row. So bytes are garbage only once they are older than any upload takes, and an upload
that finds its bytes in the store makes them young again.
"""

from __future__ import annotations

import os
from collections.abc import Callable

from trueup_service.errors import Conflict
from trueup_service.installation import unnamed_blobs
from trueup_service.locks import try_lock
from trueup_service.partial_uploads import PartialUploads
from trueup_service.registry.transaction import reading
from trueup_service.wiring import Parts

Progress = Callable[[float, str], None]


def collect_garbage(
    parts: Parts, older_than_s: float, *, dry_run: bool, progress: Progress
) -> dict[str, int]:
    """Remove unnamed blobs and abandoned uploads that are older than this [s], or with `dry_run`
    only count them. Returns the numbers of blobs, files and bytes. Raises Conflict while another
    process does it."""
    lock = try_lock(parts.settings.data_dir / "gc.lock")
    if lock is None:
        raise Conflict("somebody is at it already", hint="Wait for it to end.")
    try:
        return _remove(parts, older_than_s, dry_run=dry_run, progress=progress)
    finally:
        os.close(lock)


def _remove(
    parts: Parts, older_than_s: float, *, dry_run: bool, progress: Progress
) -> dict[str, int]:
    progress(0.0, "reading what is named")
    # A process that was killed may have left removed blobs.
    for digest in [] if dry_run else list(parts.blobs.removed()):
        if _is_named(parts, digest) and not parts.blobs.holds(digest):
            parts.blobs.restore(digest)
        else:
            parts.blobs.forget(digest)
    unnamed = unnamed_blobs(parts)
    blobs, size = 0, 0
    for count, digest in enumerate(unnamed, 1):
        progress(count / len(unnamed), f"blob {digest[:12]}")
        gone = parts.blobs.remove(digest, older_than_s, dry_run=dry_run)
        if gone is not None and not dry_run:
            if _is_named(parts, digest):
                parts.blobs.restore(digest)  # an upload of the same bytes came in between
                gone = None
            else:
                parts.blobs.forget(digest)
        blobs, size = blobs + (gone is not None), size + (gone or 0)
    files, more = PartialUploads(parts.settings.data_dir).remove_old(older_than_s, dry_run=dry_run)
    return {"blobs": blobs, "files": files, "bytes": size + more}


def _is_named(parts: Parts, digest: str) -> bool:
    with reading(parts.database) as tx:
        return tx.rows.names_blob(digest)
