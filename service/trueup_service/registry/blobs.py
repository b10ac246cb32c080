"""Blobs: bytes by their digest, created once and never changed. A blob store is a folder or any
S3-compatible store.

A put returns when the bytes are durable: a folder has synced the file and the folder that names it,
a store has acknowledged.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import AbstractContextManager
from pathlib import Path

from trueup.canonical import is_digest
from trueup.errors import TrueupError

STREAM_BYTES = 1 << 20


class BlobMissing(TrueupError):
    """The blob store does not hold these bytes."""

    code = "blob-missing"
    hint = (
        "A row names bytes that the store lost: restore them from a copy; their digest "
        "tells whether it is the right one."
    )


class BlobDamaged(TrueupError):
    """The bytes that are kept are not what their digest names."""

    code = "blob-damaged"
    hint = (
        "The stored copy is damaged or was changed: `trueup fsck` lists all such, and "
        "sending the right bytes again mends a folder."
    )

    @classmethod
    def of(cls, digest: str) -> BlobDamaged:
        """The error for a digest, which its message names."""
        return cls(f"the bytes kept for the digest {digest} are not what it names", digest=digest)


class StoreAway(TrueupError):
    """The blob store does not answer."""

    code = "store-away"
    hint = "Try again with the same Idempotency-Key; /readyz says when it is back."


class Blobs(ABC):
    """A blob store."""

    @abstractmethod
    def put(self, digest: str, source: Path) -> None:
        """Store the bytes of a file on the spool, whose digest the caller has computed.

        Storing them again changes nothing, except that a folder replaces a damaged file.
        """

    @abstractmethod
    def get(self, digest: str) -> bytes:
        """Returns all bytes. Raises BlobMissing."""

    @abstractmethod
    def stream(self, digest: str) -> Iterator[bytes]:
        """Yields the bytes in parts. Raises BlobMissing."""

    @abstractmethod
    def size(self, digest: str) -> int:
        """The size of a blob [bytes]. Raises BlobMissing."""

    @abstractmethod
    def local_copy(self, digest: str, spool: Path) -> AbstractContextManager[Path]:
        """The bytes as a file in the spool, which stays whatever happens to the blob, until the
        context is left. Raises BlobMissing."""

    @abstractmethod
    def holds(self, digest: str) -> bool:
        """Whether the store has these bytes."""

    @abstractmethod
    def all(self) -> Iterator[str]:
        """Yields the digest of every blob."""

    @abstractmethod
    def remove(self, digest: str, older_than_s: float, *, dry_run: bool) -> int | None:
        """Remove a blob that was last put longer ago than this [s], or with `dry_run` only say so.

        Returns its size [bytes], or None where the blob is younger and stays. `restore` undoes a
        removal until `forget`.
        """

    @abstractmethod
    def restore(self, digest: str) -> None:
        """Undo the removal of a blob."""

    @abstractmethod
    def forget(self, digest: str) -> None:
        """Delete a removed blob for good."""

    @abstractmethod
    def removed(self) -> Iterator[str]:
        """Yields the digests that were removed and neither forgotten nor restored, as by a process
        that was killed in between."""


def require_digest(digest: str) -> str:
    """Returns the digest if it is one, and not, say, a path. Raises BlobMissing."""
    if not is_digest(digest):
        raise BlobMissing(f"{digest!r} is no digest")
    return digest
