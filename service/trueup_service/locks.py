"""File locks that the operating system releases when their holder dies."""

from __future__ import annotations

import fcntl
import os
import shutil
import uuid
from pathlib import Path

_held: list[int] = []  # file descriptors of locks that live as long as this process


def try_lock(path: Path) -> int | None:
    """Acquire a lock. Returns a descriptor that holds it until it is closed, None where somebody
    else holds it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(handle)
        return None
    return handle


def own_folder(parent: Path) -> Path:
    """Make a folder for this process alone, and remove those of processes that are gone."""
    parent.mkdir(parents=True, exist_ok=True)
    for lock in parent.glob("*.lock"):
        handle = try_lock(lock)
        if handle is not None:
            shutil.rmtree(lock.with_suffix(""), ignore_errors=True)
            lock.unlink(missing_ok=True)
            os.close(handle)
    folder = parent / uuid.uuid4().hex
    handle = try_lock(folder.with_suffix(".lock"))
    assert handle is not None
    _held.append(handle)
    folder.mkdir()
    return folder
