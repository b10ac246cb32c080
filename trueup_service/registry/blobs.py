"""Bytes by digest: created once, never changed. A folder, or any S3-compatible store.

A put returns when the bytes are durable: on a folder the file and the folder that names it are synced, a store has acknowledged.
"""

from __future__ import annotations

import os
from abc import ABC, abstractmethod
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from trueup.canonical import is_digest
from trueup.errors import TrueupError

if TYPE_CHECKING:
    from obstore.store import S3Store

STREAM_BYTES = 1 << 20


class BlobMissing(TrueupError):
    """The blob store does not hold these bytes."""

    code = "blob-missing"
    hint = "A row names bytes that the store lost: restore them from a copy; their digest tells whether it is the right one."


class Blobs(ABC):
    """A store of immutable bytes."""

    @abstractmethod
    def put(self, digest: str, source: Path) -> None:
        """Keep the bytes of a file of ours, whose digest the caller has computed. Keeping them again changes nothing."""

    @abstractmethod
    def get(self, digest: str) -> bytes:
        """All bytes. Raises BlobMissing."""

    @abstractmethod
    def stream(self, digest: str) -> Iterator[bytes]:
        """The bytes in parts. Raises BlobMissing."""

    @abstractmethod
    def holds(self, digest: str) -> bool:
        """Whether the bytes are there."""


class FolderBlobs(Blobs):
    """Blobs as files `ab/cdef…` below a folder on the same file system as the files that are put."""

    def __init__(self, root: Path) -> None:
        self._root = root
        root.mkdir(parents=True, exist_ok=True)

    def put(self, digest: str, source: Path) -> None:
        target = self._path(digest)
        if not target.parent.is_dir():
            target.parent.mkdir(exist_ok=True)
            _sync(self._root)
        _sync(source)
        try:
            os.link(source, target)
        except FileExistsError:
            return
        _sync(target.parent)

    def get(self, digest: str) -> bytes:
        try:
            return self._path(digest).read_bytes()
        except FileNotFoundError as error:
            raise BlobMissing(digest=digest) from error

    def stream(self, digest: str) -> Iterator[bytes]:
        try:
            file = self._path(digest).open("rb")
        except FileNotFoundError as error:
            raise BlobMissing(digest=digest) from error
        with file:
            while part := file.read(STREAM_BYTES):
                yield part

    def holds(self, digest: str) -> bool:
        return self._path(digest).is_file()

    def _path(self, digest: str) -> Path:
        return self._root / _checked(digest)[:2] / digest[2:]


class S3Blobs(Blobs):
    """Blobs as objects of a bucket."""

    def __init__(self, store: S3Store) -> None:
        self._store = store

    def put(self, digest: str, source: Path) -> None:
        import obstore  # noqa: PLC0415  (only a scaled installation has a store)

        key = _checked(digest)
        if self.holds(digest):
            return
        with source.open("rb") as file:
            obstore.put(self._store, key, file)

    def get(self, digest: str) -> bytes:
        return b"".join(self.stream(digest))

    def stream(self, digest: str) -> Iterator[bytes]:
        import obstore  # noqa: PLC0415
        from obstore.exceptions import NotFoundError  # noqa: PLC0415

        try:
            found = obstore.get(self._store, _checked(digest))
        except (FileNotFoundError, NotFoundError) as error:
            raise BlobMissing(digest=digest) from error
        for part in found.stream(min_chunk_size=STREAM_BYTES):
            yield bytes(part)

    def holds(self, digest: str) -> bool:
        import obstore  # noqa: PLC0415
        from obstore.exceptions import NotFoundError  # noqa: PLC0415

        try:
            obstore.head(self._store, _checked(digest))
        except (FileNotFoundError, NotFoundError):
            return False
        return True


def _checked(digest: str) -> str:
    if not is_digest(digest):
        raise BlobMissing(f"{digest!r} is no digest")
    return digest


def _sync(path: Path) -> None:
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
