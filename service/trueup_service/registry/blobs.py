"""Bytes by digest: created once, never changed. A folder, or any S3-compatible store.

A put returns when the bytes are durable: on a folder the file and the folder that names it are
synced, a store has acknowledged.
"""

from __future__ import annotations

import contextlib
import filecmp
import hashlib
import math
import os
import time
import uuid
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from trueup.canonical import is_digest
from trueup.errors import TrueupError
from trueup.files import regular, sync

if TYPE_CHECKING:
    from obstore.store import S3Store

STREAM_BYTES = 1 << 20
PART_BYTES, PARTS = 8 << 20, 2  # of what goes to a store, and how many are held in memory
ASIDE = "removed/"
YOUNG_S = 3600.0  # what was put in the last hour is not put again


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
    """A store of immutable bytes."""

    @abstractmethod
    def put(self, digest: str, source: Path) -> None:
        """Keep the bytes of a file of ours, whose digest the caller has computed.

        Keeping them again changes nothing; a folder mends what was damaged.
        """

    @abstractmethod
    def get(self, digest: str) -> bytes:
        """All bytes. Raises BlobMissing."""

    @abstractmethod
    def stream(self, digest: str) -> Iterator[bytes]:
        """The bytes in parts. Raises BlobMissing."""

    @abstractmethod
    def size(self, digest: str) -> int:
        """How many bytes there are. Raises BlobMissing."""

    @abstractmethod
    def at_hand(self, digest: str, spool: Path) -> AbstractContextManager[Path]:
        """The bytes as a file of ours in `spool`, whatever happens to the blob meanwhile. Raises
        BlobMissing."""

    @abstractmethod
    def holds(self, digest: str) -> bool:
        """Whether the bytes are there."""

    @abstractmethod
    def all(self) -> Iterator[str]:
        """Every digest that is kept."""

    @abstractmethod
    def remove(self, digest: str, older_than_s: float, *, dry_run: bool) -> int | None:
        """Remove bytes that nobody has put for so long [s]; how many, None if they are younger.
        They can be brought back until `forget`."""

    @abstractmethod
    def bring_back(self, digest: str) -> None:
        """Undo a removal."""

    @abstractmethod
    def forget(self, digest: str) -> None:
        """Let go for good of what was removed."""

    @abstractmethod
    def removed(self) -> Iterator[str]:
        """What was removed and neither forgotten nor brought back, as by somebody who was killed
        over it."""


class FolderBlobs(Blobs):
    """Blobs as files `ab/cdef…` below a folder on the same file system as the files that are
    put."""

    def __init__(self, root: Path) -> None:
        self._root = root
        root.mkdir(parents=True, exist_ok=True)

    def put(self, digest: str, source: Path) -> None:
        target = self._path(digest)
        target.parent.mkdir(exist_ok=True)
        sync(source)
        while not self._linked(source, target):
            continue  # it was being removed: once it is gone it can be linked
        for folder in (
            target.parent,
            self._root,
        ):  # also for a file that was there: whoever linked it may not have come this far
            sync(folder)

    def _linked(self, source: Path, target: Path) -> bool:
        """Link the file, or make the one that is there young again, so that nobody takes it for
        left over; False if it went meanwhile."""
        try:
            os.link(source, target)
        except FileExistsError:
            try:
                os.utime(target)
                self._mend(target, source)
                sync(target)
            except FileNotFoundError:
                return False
        return True

    @staticmethod
    def _mend(target: Path, source: Path) -> None:
        """Replace a kept file whose bytes have changed since, by the right ones that have come
        again."""
        named = target.parent.name + target.name
        if not filecmp.cmp(target, source, shallow=False) and _digest_of(source) == named:
            beside = target.with_name(f"{target.name}.{uuid.uuid4().hex}")
            os.link(source, beside)
            beside.replace(target)

    def get(self, digest: str) -> bytes:
        try:
            with regular(self._path(digest)) as file:
                return file.read()
        except FileNotFoundError as error:
            raise BlobMissing(digest=digest) from error

    def size(self, digest: str) -> int:
        try:
            return self._path(digest).stat().st_size
        except FileNotFoundError as error:
            raise BlobMissing(digest=digest) from error

    @contextmanager
    def at_hand(self, digest: str, spool: Path) -> Iterator[Path]:
        path = spool / uuid.uuid4().hex
        if not self.holds(digest):
            raise BlobMissing(digest=digest)
        try:
            os.link(self._path(digest), path)
        except FileNotFoundError as error:
            raise BlobMissing(digest=digest) from error
        try:
            yield path
        finally:
            path.unlink(missing_ok=True)

    def stream(self, digest: str) -> Iterator[bytes]:
        try:
            file = regular(self._path(digest))
        except FileNotFoundError as error:
            raise BlobMissing(digest=digest) from error
        with file:
            while part := file.read(STREAM_BYTES):
                yield part

    def holds(self, digest: str) -> bool:
        return self._path(digest).is_file()

    def all(self) -> Iterator[str]:
        for path in self._root.glob("??/*"):
            if is_digest(digest := path.parent.name + path.name):
                yield digest

    def remove(self, digest: str, older_than_s: float, *, dry_run: bool) -> int | None:
        path, aside = self._path(digest), self._aside(digest)
        if time.time() - path.stat().st_mtime < older_than_s:
            return None
        if dry_run:
            return path.stat().st_size
        path.replace(aside)
        found = aside.stat()
        if time.time() - found.st_mtime < older_than_s:  # somebody has put it in this very moment
            self.bring_back(digest)
            return None
        return found.st_size

    def bring_back(self, digest: str) -> None:
        with contextlib.suppress(FileExistsError):
            os.link(self._aside(digest), self._path(digest))
        self._aside(digest).unlink()
        sync(self._path(digest).parent)

    def forget(self, digest: str) -> None:
        self._aside(digest).unlink(missing_ok=True)
        sync(self._root)

    def removed(self) -> Iterator[str]:
        return (path.name.removeprefix("removed-") for path in self._root.glob("removed-*"))

    def _aside(self, digest: str) -> Path:
        return self._root / f"removed-{_checked(digest)}"

    def _path(self, digest: str) -> Path:
        return self._root / _checked(digest)[:2] / digest[2:]


class S3Blobs(Blobs):
    """Blobs as objects of a bucket. A store that does not answer raises StoreAway."""

    def __init__(self, store: S3Store) -> None:
        self._store = store

    def put(self, digest: str, source: Path) -> None:
        import obstore  # noqa: PLC0415  (only a scaled installation has a store)

        if (
            self._age_s(digest) > YOUNG_S
        ):  # put again what is old, so that nobody takes it for left over
            with source.open("rb") as file, _answering(digest):
                obstore.put(
                    self._store,
                    _checked(digest),
                    file,
                    chunk_size=PART_BYTES,
                    max_concurrency=PARTS,
                )

    def get(self, digest: str) -> bytes:
        return b"".join(self.stream(digest))

    def size(self, digest: str) -> int:
        import obstore  # noqa: PLC0415

        with _answering(digest):
            return int(obstore.head(self._store, _checked(digest))["size"])

    @contextmanager
    def at_hand(self, digest: str, spool: Path) -> Iterator[Path]:
        path = spool / uuid.uuid4().hex
        try:
            with path.open("xb") as file:
                for part in self.stream(digest):
                    file.write(part)
            yield path
        finally:
            path.unlink(missing_ok=True)

    def stream(self, digest: str) -> Iterator[bytes]:
        import obstore  # noqa: PLC0415

        with _answering(digest):
            for part in obstore.get(self._store, _checked(digest)).stream(
                min_chunk_size=STREAM_BYTES
            ):
                yield bytes(part)

    def holds(self, digest: str) -> bool:
        import obstore  # noqa: PLC0415

        try:
            with _answering(digest):
                obstore.head(self._store, _checked(digest))
        except BlobMissing:
            return False
        return True

    def _age_s(self, digest: str) -> float:
        """How long ago the bytes were put [s]; infinite where they are not there."""
        import obstore  # noqa: PLC0415

        try:
            with _answering(digest):
                found = obstore.head(self._store, _checked(digest))
        except BlobMissing:
            return math.inf
        put_at: float = found["last_modified"].timestamp()
        return time.time() - put_at

    def remove(self, digest: str, older_than_s: float, *, dry_run: bool) -> int | None:
        import obstore  # noqa: PLC0415

        if self._age_s(digest) < max(older_than_s, YOUNG_S if older_than_s else 0.0):
            return None
        with _answering(digest):
            size = self.size(digest)
            if not dry_run:
                obstore.copy(self._store, digest, f"{ASIDE}{digest}")
                obstore.delete(self._store, digest)
        return size

    def bring_back(self, digest: str) -> None:
        import obstore  # noqa: PLC0415

        with _answering(digest):
            obstore.copy(self._store, f"{ASIDE}{_checked(digest)}", digest)
        self.forget(digest)

    def forget(self, digest: str) -> None:
        import obstore  # noqa: PLC0415

        with _answering(digest):
            obstore.delete(self._store, f"{ASIDE}{_checked(digest)}")

    def removed(self) -> Iterator[str]:
        import obstore  # noqa: PLC0415

        with _answering("0" * 64):
            for listed in obstore.list(self._store, prefix=ASIDE.rstrip("/")):
                yield from (str(found["path"]).removeprefix(ASIDE) for found in listed)

    def all(self) -> Iterator[str]:
        import obstore  # noqa: PLC0415

        with _answering("0" * 64):
            for listed in obstore.list(self._store):
                yield from (str(found["path"]) for found in listed if is_digest(str(found["path"])))


@contextmanager
def _answering(digest: str) -> Iterator[None]:
    """The store's errors as ours."""
    from obstore.exceptions import BaseError, NotFoundError  # noqa: PLC0415

    try:
        yield
    except (FileNotFoundError, NotFoundError) as error:
        raise BlobMissing(digest=digest) from error
    except (BaseError, OSError) as error:
        raise StoreAway(f"the blob store does not answer: {type(error).__name__}") from error


def _checked(digest: str) -> str:
    if not is_digest(digest):
        raise BlobMissing(f"{digest!r} is no digest")
    return digest


def _digest_of(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
