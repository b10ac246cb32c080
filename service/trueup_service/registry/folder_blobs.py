"""Blobs in a folder: the file of a digest `abcdef…` is `ab/cdef…`."""

from __future__ import annotations

import contextlib
import filecmp
import hashlib
import os
import time
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from trueup.canonical import is_digest
from trueup.files import regular, sync
from trueup_service.registry.blobs import STREAM_BYTES, BlobMissing, Blobs, require_digest

REMOVED = "removed-"  # what a file is called until it is forgotten or restored


class FolderBlobs(Blobs):
    """Blobs as files below a folder, which lies on the same file system as the files that are
    put."""

    def __init__(self, root: Path) -> None:
        self._root = root
        root.mkdir(parents=True, exist_ok=True)

    def put(self, digest: str, source: Path) -> None:
        target = self._path(digest)
        target.parent.mkdir(exist_ok=True)
        sync(source)
        while not self._link(source, target):
            continue  # the file was removed in this moment, and can be linked now
        # Also where the file was there: the process that linked it may have died before this.
        for folder in (target.parent, self._root):
            sync(folder)

    def _link(self, source: Path, target: Path) -> bool:
        """Link the file, or touch the one that is there, so that garbage collection does not take
        it. Returns False where that one was removed meanwhile."""
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
        """Replace a damaged file by the right bytes, which were put again."""
        digest = target.parent.name + target.name
        if not filecmp.cmp(target, source, shallow=False) and _digest_of(source) == digest:
            temporary = target.with_name(f"{target.name}.{uuid.uuid4().hex}")
            os.link(source, temporary)
            temporary.replace(target)

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
    def local_copy(self, digest: str, spool: Path) -> Iterator[Path]:
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
        path, removed = self._path(digest), self._removed_path(digest)
        if time.time() - path.stat().st_mtime < older_than_s:
            return None
        if dry_run:
            return path.stat().st_size
        path.replace(removed)
        status = removed.stat()
        if time.time() - status.st_mtime < older_than_s:  # it was put in this very moment
            self.restore(digest)
            return None
        return status.st_size

    def restore(self, digest: str) -> None:
        with contextlib.suppress(FileExistsError):
            os.link(self._removed_path(digest), self._path(digest))
        self._removed_path(digest).unlink()
        sync(self._path(digest).parent)

    def forget(self, digest: str) -> None:
        self._removed_path(digest).unlink(missing_ok=True)
        sync(self._root)

    def removed(self) -> Iterator[str]:
        return (path.name.removeprefix(REMOVED) for path in self._root.glob(f"{REMOVED}*"))

    def _removed_path(self, digest: str) -> Path:
        return self._root / f"{REMOVED}{require_digest(digest)}"

    def _path(self, digest: str) -> Path:
        return self._root / require_digest(digest)[:2] / digest[2:]


def _digest_of(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
