"""Files: opened where somebody else may have put one, and written so that they survive a crash."""

from __future__ import annotations

import os
import stat
import uuid
from collections.abc import Iterable
from pathlib import Path
from typing import BinaryIO


def regular(path: Path) -> BinaryIO:
    """A regular file, open to be read: a pipe would wait for a writer, and a device never end.
    Raises FileNotFoundError, OSError."""
    handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    if not stat.S_ISREG(os.fstat(handle).st_mode):
        os.close(handle)
        raise FileNotFoundError(f"{path} is no regular file")
    return os.fdopen(handle, "rb")


def sync(path: Path) -> None:
    """Make the bytes of a file, or the names in a folder, durable."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def write_new(path: Path, data: bytes, mode: int = 0o666) -> None:
    """Write a file that is not there yet, and make its bytes durable. Raises FileExistsError."""
    _write(path, [data], mode)


def write_durably(path: Path, parts: Iterable[bytes], mode: int = 0o666) -> None:
    """Write a file under another name, make its bytes durable, then give it its name: a reader sees
    the file before or the new one, whole. The name is durable once its folder is synced."""
    beside = path.with_name(f"{path.name}.{uuid.uuid4().hex}")
    try:
        _write(beside, parts, mode)
        beside.replace(path)
    finally:
        beside.unlink(missing_ok=True)


def _write(path: Path, parts: Iterable[bytes], mode: int) -> None:
    with open(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode), "wb") as file:
        file.writelines(parts)
        file.flush()
        os.fsync(file.fileno())
