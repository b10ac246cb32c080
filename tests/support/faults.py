"""Run the command with fault injection: `python -m tests.support.faults serve …`.

A fault is armed by the file that FAULT_FILE names, which holds `<what> <n>`. At the n-th step from
then on the process is killed (`kill`), or that step fails (`ENOSPC`, `EIO`, …), and the file is
removed; compute processes of a worker count their steps, too. Steps are each write of an upload,
fsync, link, rename, put into a store, and both sides of each commit.
"""

from __future__ import annotations

import errno
import os
import signal
import sys
import threading
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

FILE = Path(os.environ.get("FAULT_FILE", "/nonexistent"))
_lock = threading.Lock()
_left: dict[str, int] = {}


def arm(path: Path, what: str, at: int) -> None:
    """Arms a fault in the process that watches this file."""
    partial = path.with_suffix(".arming")
    partial.write_text(f"{what} {at}")
    partial.replace(path)


def step(name: str, error_of: Callable[[str], BaseException]) -> None:
    """Counts one step, and injects the fault if this is the step that it waits for."""
    with _lock:
        try:
            what, at = FILE.read_text().split()
        except (OSError, ValueError):
            _left.clear()
            return
        left = _left[what] = _left.get(what, int(at)) - 1
        if left > 0:
            return
        _left.clear()
        FILE.unlink()
    print(f"fault: {what} at {name}", file=sys.stderr, flush=True)
    if what == "kill":
        os.kill(os.getpid(), signal.SIGKILL)
    raise error_of(what)


def _os_error(what: str) -> OSError:
    number = getattr(errno, what)
    return OSError(number, os.strerror(number))


def _wrap(owner: Any, name: str, error_of: Callable[[str], BaseException] = _os_error) -> None:
    original = getattr(owner, name)

    def stepped(*arguments: Any, **more: Any) -> Any:
        step(name, error_of)
        return original(*arguments, **more)

    setattr(owner, name, stepped)


def install() -> None:
    """Wraps the functions that are steps."""
    import obstore
    from sqlalchemy.engine.default import DefaultDialect

    from trueup_service.http.uploads import _Sink

    for name in ("fsync", "fdatasync", "link", "replace"):
        _wrap(os, name)
    _wrap(_Sink, "take")
    _wrap(obstore, "put")
    commit = DefaultDialect.do_commit

    def do_commit(self: Any, connection: Any) -> None:
        lost: Callable[[str], BaseException] = self.dbapi.OperationalError
        step("commit", lost)
        commit(self, connection)
        step("committed", lost)

    DefaultDialect.do_commit = do_commit  # type: ignore[method-assign]


def serve(file: Path, *arguments: Any) -> None:
    """Runs a compute process of a worker with the same faults in it."""
    from trueup_worker.compute_process import _serve

    global FILE  # noqa: PLW0603  (of the process that this one computes for)
    FILE = file
    install()
    _serve(*arguments)


if __name__ == "__main__":
    from tests.support import faults  # noqa: PLW0406  (the copy that others can import)
    from trueup_cli.main import main
    from trueup_worker import compute_process

    install()
    compute_process._serve = partial(faults.serve, FILE)
    main()
