"""Uploads that go on where they broke off: a file for each, named by the plant and the digest that it will have.

What was acknowledged is durable: a part is synced before its answer. The files lie on the disk of the server that took them; another server
begins anew.
"""

from __future__ import annotations

import asyncio
import fcntl
import hashlib
import os
import time
from collections.abc import AsyncIterator, Iterator
from contextlib import contextmanager
from io import FileIO
from pathlib import Path

from trueup_service.errors import TooLargeUpload, UploadElsewhere

PART_BYTES = 1 << 20


class PartialUploads:
    """The uploads of a data folder."""

    def __init__(self, data_dir: Path) -> None:
        self._folder = data_dir / "uploads"

    def path(self, plant: str, digest: str) -> Path:
        """Where an upload is: its name tells nothing, and is no path whatever the plant is called."""
        return self._folder / hashlib.sha256(f"{plant}\n{digest}".encode()).hexdigest()

    def offset(self, plant: str, digest: str) -> int:
        """How many bytes are here, and durable."""
        try:
            with self.path(plant, digest).open("rb") as file:
                os.fsync(file.fileno())
                return file.seek(0, os.SEEK_END)
        except FileNotFoundError:
            return 0

    async def append(self, plant: str, digest: str, offset: int, parts: AsyncIterator[bytes], limit_bytes: int) -> int:
        """Take parts in behind an offset; how many bytes are here then. What came is kept, also where the rest does not.

        Raises UploadElsewhere where the upload is not at this offset or somebody else is writing it, TooLargeUpload.
        """
        self._folder.mkdir(mode=0o700, exist_ok=True)
        with _alone(self.path(plant, digest)) as file:
            here = file.seek(0, os.SEEK_END)
            if here != offset:
                raise UploadElsewhere(f"the upload is at {here}, not at {offset}", offset_bytes=here)
            try:
                async for part in parts:
                    if file.tell() + len(part) > limit_bytes:
                        raise TooLargeUpload(f"the upload has more than {limit_bytes} bytes", limit_bytes=limit_bytes)
                    file.write(part)
            finally:
                await asyncio.to_thread(os.fsync, file.fileno())
            return file.tell()

    def drop(self, plant: str, digest: str) -> None:
        """Forget an upload."""
        self.path(plant, digest).unlink(missing_ok=True)

    def remove_old(self, older_than_s: float, *, dry_run: bool) -> tuple[int, int]:
        """Remove uploads that nobody went on with for so long [s]: how many, and their bytes."""
        files, size = 0, 0
        for path in self._folder.glob("*"):
            found = path.stat()
            if time.time() - found.st_mtime >= older_than_s:
                files, size = files + 1, size + found.st_size
                if not dry_run:
                    path.unlink()
        return files, size


@contextmanager
def _alone(path: Path) -> Iterator[FileIO]:
    """The file, while nobody else writes it. Raises UploadElsewhere."""
    with open(os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600), "r+b", buffering=0) as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise UploadElsewhere("somebody else is sending this upload") from error
        yield file


def digest_of_file(path: Path) -> str:
    """SHA-256 of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
