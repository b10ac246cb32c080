"""The data folder is its owner's alone: log, keys, tokens' hashes and recordings of robots lie in
it.

A folder that was made by hand, copied or unpacked from an archive may be open to others; it is
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
    """Make the folder, or close it to others, and the database in it, whose companions get the
    permissions that it has."""
    path.mkdir(mode=FOLDER, parents=True, exist_ok=True)
    _tighten(path, FOLDER)
    if database is not None and database.parent.is_dir():
        with contextlib.suppress(
            FileExistsError
        ):  # one that is there is not opened: closing it would free the locks that SQLite holds
            os.close(os.open(database, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, FILE))
        _tighten(database, FILE)
    for pattern in FILES:
        for found in path.glob(pattern):
            _tighten(found, FILE)


def _tighten(path: Path, mode: int) -> None:
    """Take away what others may do with a folder or file of ours; a link is left as it is."""
    found = path.lstat()
    loose = stat.S_IMODE(found.st_mode)
    if stat.S_ISLNK(found.st_mode) or not loose & ~mode:
        return
    told = {"path": str(path), "mode": f"{loose:04o}"}
    try:
        path.chmod(loose & mode)
    except PermissionError:  # a volume that somebody else owns and lets us use
        log.warning(
            "others may read what is the service's own, and only its owner can change that",
            extra=told,
        )
    else:
        log.warning("was open to others, and is closed now", extra=told)
