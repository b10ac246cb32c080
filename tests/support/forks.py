"""Processes of the service that start quickly: forked from one that has loaded the imports.

Each process has its own environment, runs a module as `python -m` does, and can be killed. Its
`atexit` handlers do not run.
"""

from __future__ import annotations

import contextlib
import importlib
import multiprocessing
import os
import runpy
import signal
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Mapping, Sequence
from multiprocessing import forkserver
from multiprocessing.reduction import DupFd
from pathlib import Path
from typing import Any

# what the command imports of others; the last one loads what is ours
PRELOADED = [
    "cyclopts", "dbos", "fastapi", "numba", "obstore", "psycopg", "rich.console", "rich.progress",
    "rich.table", "uvicorn", "uvloop", "tests.support.fork_server",
]  # fmt: skip
# which says what its own are forked from; where tests run, they are forked from the same
importlib.import_module("trueup_worker.compute_process")
_context = multiprocessing.get_context("forkserver")
_context.set_forkserver_preload(PRELOADED)
# Read before an effect is compiled, or when the compiler is loaded: a process that has another
# value of one of these begins anew.
READ_AT_START = ("TRUEUP_EFFECTS", "TRUEUP_SIMULATORS", "NUMBA_CACHE_DIR")
# by which a process reaches the one that forks; the key from Python 3.14 on
REACHED_BY = ("_forkserver_address", "_forkserver_authkey")


class Forked:
    """A child process, with the methods of `subprocess.Popen` that tests use."""

    def __init__(
        self,
        module: str,
        arguments: Sequence[str],
        environment: Mapping[str, str],
        cwd: Path,
        outputs: Sequence[int] = (1, 2),
    ) -> None:
        """`outputs` are the descriptors for its standard output and standard error."""
        passed = [_Descriptor(number) for number in outputs]
        forkserver._forkserver.ensure_running()
        server = {
            name: value
            for name, value in vars(forkserver._forkserver).items()
            if name in REACHED_BY
        }
        self._process = _context.Process(
            target=_run, args=(module, list(arguments), dict(environment), cwd, passed, server)
        )
        self._process.start()
        self.pid = self._process.pid

    @property
    def returncode(self) -> int | None:
        """The exit code; None while the process runs."""
        return self._process.exitcode

    def poll(self) -> int | None:
        """Returns the exit code; None while the process runs."""
        return self.returncode

    def wait(self, timeout: float | None = None) -> int:
        """Waits for the end, and returns the exit code. Raises TimeoutExpired."""
        self._process.join(timeout)
        if self.returncode is None:
            raise subprocess.TimeoutExpired(str(self.pid), timeout or 0.0)
        return self.returncode

    def send_signal(self, number: int) -> None:
        """Sends a signal, if the process still runs."""
        if self.returncode is None:
            with contextlib.suppress(ProcessLookupError):
                os.kill(self.pid, number)

    def terminate(self) -> None:
        """Sends SIGTERM."""
        self.send_signal(signal.SIGTERM)

    def kill(self) -> None:
        """Sends SIGKILL."""
        self.send_signal(signal.SIGKILL)


def run(
    module: str, arguments: Sequence[str], environment: Mapping[str, str], cwd: Path
) -> subprocess.CompletedProcess:
    """Runs a module to its end, with its output captured as text."""
    with tempfile.TemporaryFile("w+") as out, tempfile.TemporaryFile("w+") as err:
        code = Forked(module, arguments, environment, cwd, [out.fileno(), err.fileno()]).wait()
        for file in (out, err):
            file.seek(0)
        return subprocess.CompletedProcess(list(arguments), code, out.read(), err.read())


class _Descriptor:
    """A file descriptor that is passed to a child."""

    def __init__(self, number: int) -> None:
        self._number = number

    def __reduce__(self) -> tuple[Any, ...]:
        return _detached, (DupFd(self._number),)


def _detached(descriptor: Any) -> int:
    return descriptor.detach()


def _run(
    module: str,
    arguments: list[str],
    environment: dict[str, str],
    cwd: Path,
    outputs: Sequence[int],
    server: dict[str, Any],
) -> None:
    # The compute processes of a worker are forked from the process that this one was forked from.
    vars(forkserver._forkserver).update(server)
    forkserver._forkserver.ensure_running = lambda: None
    for number, file in enumerate(outputs, 1):
        os.dup2(file, number)
        os.close(file)
    before = dict(os.environ)
    os.environ.clear()
    os.environ.update(environment)
    os.chdir(cwd)
    if any(environment.get(name) != before.get(name) for name in READ_AT_START):
        os.execve(sys.executable, [sys.executable, "-m", module, *arguments], environment)
    sys.argv = [module, *arguments]
    if "PYTHONWARNINGS" in environment:  # which an interpreter reads only at its start
        warnings.simplefilter(environment["PYTHONWARNINGS"])  # type: ignore[arg-type]
    runpy.run_module(module, run_name="__main__", alter_sys=True)
