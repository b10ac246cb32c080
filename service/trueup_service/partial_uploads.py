"""Uploads that go on where they broke off: a file for each, in a folder for each plant.

What was acknowledged is durable: a part is synced before its answer. The files lie on the disk of
the server that took them; another server begins anew. A plant has a quota of them; nothing that was
acknowledged goes to make room, but only by its age.
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

RECOUNT_BYTES = 8 << 20  # after so many more, what a plant has under way is looked at again


@dataclass(frozen=True, slots=True)
class Quota:
    """How many uploads a plant may have under way, and how many bytes of them."""

    uploads: int
    size_bytes: int


class PartialUploads:
    """The uploads of a data folder."""

    def __init__(self, data_dir: Path) -> None:
        self._folder = data_dir / "uploads"

    def path(self, plant: str, digest: str) -> Path:
        """Where an upload is: its name tells nothing, and is no path whatever the plant is
        called."""
        name = hashlib.sha256(f"{plant}\n{digest}".encode()).hexdigest()
        before = self._folder / name  # where one is that began when all were in one folder
        return before if before.is_file() else self._of(plant) / name

    def _of(self, plant: str) -> Path:
        return self._folder / f"plant-{hashlib.sha256(plant.encode()).hexdigest()}"

    def offset(self, plant: str, digest: str) -> int:
        """How many bytes are here, and durable."""
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
        """Take parts in behind an offset; how many bytes are here then. What came is kept, also
        where the rest does not.

        Raises UploadElsewhere where the upload is not at this offset or somebody else is writing
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
                        told = (
                            f"the plant's uploads under way have more than {quota.size_bytes} bytes"
                        )
                        raise UploadsFull(told, limit_bytes=quota.size_bytes)
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
        """The upload's file, while nobody else writes it. Raises UploadElsewhere,
        FileNotFoundError."""
        path = self.path(plant, digest)
        flags = os.O_RDWR | os.O_CLOEXEC | (os.O_CREAT if create else 0)
        with open(os.open(path, flags, 0o600), "r+b", buffering=0) as file:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError as error:
                raise UploadElsewhere("somebody else is sending this upload") from error
            found = os.fstat(file.fileno())
            if found.st_nlink != 1 or not path.exists() or path.stat().st_ino != found.st_ino:
                raise UploadElsewhere(
                    "the upload has just been finished"
                )  # its bytes are an episode's by now
            yield file

    def _others(self, plant: str, digest: str, quota: Quota) -> int:
        """Bytes of the plant's other uploads. Raises UploadsFull where these are as many as there
        may be, and this is a new one."""
        own = self.path(plant, digest)
        sizes = [
            found
            for path in self._of(plant).glob("*")
            if path != own and (found := _size(path)) is not None
        ]
        if len(sizes) >= quota.uploads and not own.exists():
            raise UploadsFull(f"the plant has {len(sizes)} uploads under way", limit=quota.uploads)
        return sum(sizes)

    def drop(self, plant: str, digest: str) -> None:
        """Forget an upload."""
        self.path(plant, digest).unlink(missing_ok=True)

    def remove_old(self, older_than_s: float, *, dry_run: bool) -> tuple[int, int]:
        """Remove uploads that nobody went on with for so long [s]: how many, and their bytes."""
        files, size = 0, 0
        for path in [path for path in self._folder.rglob("*") if path.is_file()]:
            found = path.stat()
            if time.time() - found.st_mtime >= older_than_s:
                files, size = files + 1, size + found.st_size
                if not dry_run:
                    path.unlink(missing_ok=True)
        return files, size


def _size(path: Path) -> int | None:
    """A file's bytes, None where it has just gone."""
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
