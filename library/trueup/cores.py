"""How many cores there are, work shared out over them, and what its threads take."""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import Any

ARENAS = -8  # the name of glibc's M_ARENA_MAX
_at_most: list[int] = []  # cores that this process was told to use; empty: all that it may


def one_arena() -> bool:
    """Let every thread of this process take memory from one arena, and whether that was granted.

    The GNU C library gives each thread an arena of its own, which keeps what the thread once
    needed: a third of what a diagnosis takes. Elsewhere nothing is done. For programs that begin,
    before they begin threads; a library must not decide it. Source: mallopt(3).
    """
    if not sys.platform.startswith("linux"):
        return False
    limit = getattr(ctypes.CDLL(None), "mallopt", None)
    return bool(limit is not None and limit(ARENAS, 1) == 1)


def one_blas_thread() -> None:
    """Let numpy multiply matrices on one thread, unless OPENBLAS_NUM_THREADS is set.

    Ours are small, and the work is shared out over the cores already: further threads would only
    spin while they wait. For programs that begin, before they load numpy.
    """
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


def own_cores() -> list[int]:
    """The numbers of the cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return sorted(os.sched_getaffinity(0))
    return list(range(os.cpu_count() or 1))


@cache
def cores() -> int:
    """How many cores this process shares work over."""
    return min([len(own_cores()), *_at_most])


def use_one() -> None:
    """Let this process share work over one core from now on, since others use the rest."""
    _at_most.append(1)
    cores.cache_clear()


def in_parallel(work: Callable[[Any], Any], items: Sequence[Any]) -> Iterator[Any]:
    """Map over threads, in order. Compiled code holds no lock, so it runs on all cores.

    With one core, or one item, the calling thread does the work itself: handing it over can take
    longer than doing it.
    """
    if min(cores(), len(items)) <= 1:
        yield from map(work, items)
        return
    with ThreadPoolExecutor(cores()) as pool:
        yield from pool.map(work, items)
