"""Uploads in parts, which go on where they broke off: one file for each upload, in a folder for
each plant.

What was acknowledged is durable: a part is synced before the response. The files lie on the disk of
the server that received them, and another server begins anew. Each plant has a quota. What was
acknowledged is not removed to make room, but only by its age.
"""

from __future__ import annotations

import asyncio
import fcntl
import hashlib
import os
import time
from collections.abc import AsyncIterator, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from io import FileIO
from pathlib import Path

from trueup_service.errors import TooLargeUpload, UploadElsewhere, UploadsFull

RECOUNT_BYTES = 8 << 20  # after so many more, the other uploads of the plant are counted again


@dataclass(frozen=True, slots=True)
class Quota:
    """How many uploads in parts a plant may have, and how many bytes together."""

    uploads: int
    size_bytes: int


class PartialUploads:
    """The uploads in parts below a data folder."""

    def __init__(self, data_dir: Path) -> None:
        self._folder = data_dir / "uploads"

    def path(self, plant: str, digest: str) -> Path:
        """The path of an upload. Its name is a digest, and so safe whatever the plant is called."""
        name = hashlib.sha256(f"{plant}\n{digest}".encode()).hexdigest()
        before = self._folder / name  # where an upload is that began when all were in one folder
        return before if before.is_file() else self._of(plant) / name

    def _of(self, plant: str) -> Path:
        return self._folder / f"plant-{hashlib.sha256(plant.encode()).hexdigest()}"

    def offset(self, plant: str, digest: str) -> int:
        """How many bytes of an upload are durable."""
        try:
            with self.path(plant, digest).open("rb") as file:
                os.fsync(file.fileno())
                return file.seek(0, os.SEEK_END)
        except FileNotFoundError:
            return 0

    async def append(
        self,
        plant: str,
        digest: str,
        offset: int,
        parts: AsyncIterator[bytes],
        limit_bytes: int,
        quota: Quota,
    ) -> int:
        """Append parts to an upload behind an offset. Returns how many bytes it has then. What was
        received stays, also where the rest does not come.

        Raises UploadElsewhere where the upload is not at this offset or another request is writing
        it, TooLargeUpload, UploadsFull.
        """
        self._of(plant).mkdir(mode=0o700, parents=True, exist_ok=True)
        others = self._others(plant, digest, quota)
        with self.alone(plant, digest, create=True) as file:
            here = file.seek(0, os.SEEK_END)
            if here != offset:
                raise UploadElsewhere(
                    f"the upload is at {here}, not at {offset}", offset_bytes=here
                )
            try:
                counted = here
                async for part in parts:
                    if file.tell() - counted > RECOUNT_BYTES:
                        others, counted = self._others(plant, digest, quota), file.tell()
                    if others + file.tell() + len(part) > quota.size_bytes:
                        message = (
                            f"the plant's uploads under way have more than {quota.size_bytes} bytes"
                        )
                        raise UploadsFull(message, limit_bytes=quota.size_bytes)
                    if file.tell() + len(part) > limit_bytes:
                        raise TooLargeUpload(
                            f"the upload has more than {limit_bytes} bytes", limit_bytes=limit_bytes
                        )
                    write_all(file, part)
            finally:
                await asyncio.to_thread(os.fsync, file.fileno())
            return file.tell()

    @contextmanager
    def alone(self, plant: str, digest: str, *, create: bool = False) -> Iterator[FileIO]:
        """The file of an upload, while no other request writes it. Raises UploadElsewhere,
        FileNotFoundError."""
        path = self.path(plant, digest)
        flags = os.O_RDWR | os.O_CLOEXEC | (os.O_CREAT if create else 0)
        with open(os.open(path, flags, 0o600), "r+b", buffering=0) as file:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError as error:
                raise UploadElsewhere("somebody else is sending this upload") from error
            status = os.fstat(file.fileno())
            if status.st_nlink != 1 or not path.exists() or path.stat().st_ino != status.st_ino:
                raise UploadElsewhere(
                    "the upload has just been finished"
                )  # its bytes belong to an episode now
            yield file

    def _others(self, plant: str, digest: str, quota: Quota) -> int:
        """The bytes of the plant's other uploads. Raises UploadsFull where this upload is new and
        the plant has as many as it may."""
        own = self.path(plant, digest)
        sizes = [
            size
            for path in self._of(plant).glob("*")
            if path != own and (size := _size(path)) is not None
        ]
        if len(sizes) >= quota.uploads and not own.exists():
            raise UploadsFull(f"the plant has {len(sizes)} uploads under way", limit=quota.uploads)
        return sum(sizes)

    def drop(self, plant: str, digest: str) -> None:
        """Delete an upload."""
        self.path(plant, digest).unlink(missing_ok=True)

    def remove_old(self, older_than_s: float, *, dry_run: bool) -> tuple[int, int]:
        """Remove uploads that nobody has continued for so long [s], or with `dry_run` only count
        them. Returns their number and their bytes."""
        files, size = 0, 0
        for path in [path for path in self._folder.rglob("*") if path.is_file()]:
            status = path.stat()
            if time.time() - status.st_mtime >= older_than_s:
                files, size = files + 1, size + status.st_size
                if not dry_run:
                    path.unlink(missing_ok=True)
        return files, size


def _size(path: Path) -> int | None:
    """The size of a file [bytes], None where it was removed meanwhile."""
    try:
        return path.stat().st_size
    except FileNotFoundError:
        return None


def write_all(file: FileIO, data: bytes | bytearray) -> None:
    """Write every byte, however few the kernel takes at once."""
    view = memoryview(data)
    while view:
        view = view[file.write(view) or 0 :]


def digest_of_file(path: Path) -> str:
    """SHA-256 of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
