"""Blobs as objects of a bucket in an S3-compatible store.

This module imports obstore, which only a scaled installation has.
"""

from __future__ import annotations

import math
import time
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import obstore
from obstore.exceptions import BaseError, NotFoundError
from obstore.store import S3Store

from trueup.canonical import is_digest
from trueup_service.registry.blobs import (
    STREAM_BYTES,
    BlobMissing,
    Blobs,
    StoreAway,
    require_digest,
)

PART_BYTES, PARTS = 8 << 20, 2  # of an upload to the store, and how many are held in memory
REMOVED = "removed/"  # the folder of an object until it is forgotten or restored
NO_DIGEST = "0" * 64
YOUNG_S = 3600.0  # [s] what was put in the last hour is not put again


class S3Blobs(Blobs):
    """Blobs as objects of a bucket. A store that does not answer raises StoreAway."""

    def __init__(self, store: S3Store) -> None:
        self._store = store

    def put(self, digest: str, source: Path) -> None:
        # What is old is put again, so that garbage collection does not take it.
        if self._age_s(digest) > YOUNG_S:
            with source.open("rb") as file, _translated(digest):
                obstore.put(
                    self._store,
                    require_digest(digest),
                    file,
                    chunk_size=PART_BYTES,
                    max_concurrency=PARTS,
                )

    def get(self, digest: str) -> bytes:
        return b"".join(self.stream(digest))

    def size(self, digest: str) -> int:
        with _translated(digest):
            return int(obstore.head(self._store, require_digest(digest))["size"])

    @contextmanager
    def local_copy(self, digest: str, spool: Path) -> Iterator[Path]:
        path = spool / uuid.uuid4().hex
        try:
            with path.open("xb") as file:
                for part in self.stream(digest):
                    file.write(part)
            yield path
        finally:
            path.unlink(missing_ok=True)

    def stream(self, digest: str) -> Iterator[bytes]:
        with _translated(digest):
            for part in obstore.get(self._store, require_digest(digest)).stream(
                min_chunk_size=STREAM_BYTES
            ):
                yield bytes(part)

    def holds(self, digest: str) -> bool:
        try:
            with _translated(digest):
                obstore.head(self._store, require_digest(digest))
        except BlobMissing:
            return False
        return True

    def _age_s(self, digest: str) -> float:
        """How long ago the bytes were put [s], infinite where the store does not have them."""
        try:
            with _translated(digest):
                metadata = obstore.head(self._store, require_digest(digest))
        except BlobMissing:
            return math.inf
        put_at: float = metadata["last_modified"].timestamp()
        return time.time() - put_at

    def remove(self, digest: str, older_than_s: float, *, dry_run: bool) -> int | None:
        if self._age_s(digest) < max(older_than_s, YOUNG_S if older_than_s else 0.0):
            return None
        with _translated(digest):
            size = self.size(digest)
            if not dry_run:
                obstore.copy(self._store, digest, f"{REMOVED}{digest}")
                obstore.delete(self._store, digest)
        return size

    def restore(self, digest: str) -> None:
        with _translated(digest):
            obstore.copy(self._store, f"{REMOVED}{require_digest(digest)}", digest)
        self.forget(digest)

    def forget(self, digest: str) -> None:
        with _translated(digest):
            obstore.delete(self._store, f"{REMOVED}{require_digest(digest)}")

    def removed(self) -> Iterator[str]:
        with _translated(NO_DIGEST):
            for listed in obstore.list(self._store, prefix=REMOVED.rstrip("/")):
                yield from (str(blob["path"]).removeprefix(REMOVED) for blob in listed)

    def all(self) -> Iterator[str]:
        with _translated(NO_DIGEST):
            for listed in obstore.list(self._store):
                yield from (str(blob["path"]) for blob in listed if is_digest(str(blob["path"])))


@contextmanager
def _translated(digest: str) -> Iterator[None]:
    """Turns the errors of the store into BlobMissing and StoreAway."""
    try:
        yield
    except (FileNotFoundError, NotFoundError) as error:
        raise BlobMissing(digest=digest) from error
    except (BaseError, OSError) as error:
        raise StoreAway(f"the blob store does not answer: {type(error).__name__}") from error
