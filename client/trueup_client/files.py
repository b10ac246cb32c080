"""Files on a robot's disk: digests, folders synced, and an artifact's two files checked whole."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO, TypeAlias

from trueup_client.connection import STREAM_BYTES

# called with the share that was sent, 0 to 1
Progress: TypeAlias = "Callable[[float], None]"


def no_progress(_: float) -> None:
    """Ignores the progress of an upload."""


class ReadProgress:
    """A file to send from `offset` on, which reports how much of it was read."""

    def __init__(self, path: str | os.PathLike[str], progress: Progress, offset: int = 0) -> None:
        self._file: BinaryIO = open(path, "rb")  # noqa: SIM115  (closed by whoever sends it)
        self._file.seek(offset)
        self._size, self._progress = max(os.path.getsize(path), 1), progress

    def read(self, length: int = STREAM_BYTES) -> bytes:
        """Returns the next bytes, at least STREAM_BYTES at a time, and reports the share read."""
        part = self._file.read(max(length, STREAM_BYTES))
        self._progress(self._file.tell() / self._size)
        return part

    def close(self) -> None:
        """Closes the file."""
        self._file.close()


def sync_folder(folder: Path) -> None:
    """Makes the names in a folder durable."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def digest_of(path: str | os.PathLike[str]) -> str:
    """Returns the SHA-256 of a file, in hexadecimal."""
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def arrays_digest(manifest: Path) -> str | None:
    """Returns the digest of the arrays that a manifest names; None if the artifact has no arrays.

    The manifest must have been verified before.
    """
    arrays = json.loads(manifest.read_bytes())["arrays"]
    return None if arrays is None else str(arrays["sha256"])


def is_whole(folder: Path, digest: str) -> bool:
    """Whether a fetched artifact is on disk as its digest names it, arrays included."""
    manifest = folder / "manifest.json"
    if not manifest.is_file() or digest_of(manifest) != digest:
        return False
    expected, arrays = arrays_digest(manifest), folder / "arrays.safetensors"
    if expected is None:
        return not arrays.exists()
    return arrays.is_file() and digest_of(arrays) == expected
