"""Files that others may have put where ours belong."""

from __future__ import annotations

import os
import stat
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
