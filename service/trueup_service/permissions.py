"""Permissions of the data folder, which only its owner may read: it holds the log, keys, digests of
tokens, and recordings of robots.

A folder that was made by hand, copied or unpacked from an archive may be open to others. It is
closed at each start, and the log says so.
"""

from __future__ import annotations

import contextlib
import logging
import os
import stat
from pathlib import Path

FOLDER, FILE = 0o700, 0o600
FILES = ("trueup.sqlite*", "signing.key*", "admin.token", "service.log")
log = logging.getLogger("trueup")


def make_private(path: Path, database: Path | None) -> None:
    """Make the data folder and the database in it, or close them to others. Files that SQLite puts
    beside the database get its permissions."""
    path.mkdir(mode=FOLDER, parents=True, exist_ok=True)
    _tighten(path, FOLDER)
    if database is not None and database.parent.is_dir():
        # An existing file is not opened: closing it would release the locks that SQLite holds.
        with contextlib.suppress(FileExistsError):
            os.close(os.open(database, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, FILE))
        _tighten(database, FILE)
    for pattern in FILES:
        for file in path.glob(pattern):
            _tighten(file, FILE)


def _tighten(path: Path, mode: int) -> None:
    """Remove the permissions of others from a folder or file. A link stays as it is."""
    status = path.lstat()
    loose = stat.S_IMODE(status.st_mode)
    if stat.S_ISLNK(status.st_mode) or not loose & ~mode:
        return
    facts = {"path": str(path), "mode": f"{loose:04o}"}
    try:
        path.chmod(loose & mode)
    except PermissionError:  # on a volume that another user owns
        log.warning(
            "others may read what is the service's own, and only its owner can change that",
            extra=facts,
        )
    else:
        log.warning("was open to others, and is closed now", extra=facts)
