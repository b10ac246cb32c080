"""How many cores there are to share work out over."""

from __future__ import annotations

import os
from functools import cache


@cache
def cores() -> int:
    """Cores that this process may use."""
    return (
        len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else (os.cpu_count() or 1)
    )
