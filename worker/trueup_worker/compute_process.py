"""A compute process: it computes one job, or one part of a job, at a time.

Workers compute in processes of their own. A job that exhausts memory or crashes in compiled code
ends its process and not the worker, and a limit on memory or time is enforced by the operating
system. The process ends when its worker does.
"""

from __future__ import annotations

import faulthandler
import gc
import json
import logging
import multiprocessing
import os
import queue
import resource
import signal
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, Generic, Protocol, TypeVar

from sqlalchemy.exc import SQLAlchemyError

from trueup.cores import cores, one_arena
from trueup_service import open_telemetry
from trueup_service.logs import configure_logs
from trueup_service.settings import Settings
from trueup_service.wiring import Parts, build

log = logging.getLogger("trueup.worker")

# Processes are forked from one that has loaded what they need and has no other thread.
CONTEXT = multiprocessing.get_context("forkserver")
CONTEXT.set_forkserver_preload(["trueup_worker.run_job", "trueup_service.engine"])
WORKER = "trueup-worker"  # the name of its traces
FAULT_LINES = 12  # of a crash's traceback


class ProcessEnded(Exception):
    """A compute process ended before it answered."""

    def __init__(self, how: str, traceback: str) -> None:
        super().__init__(how)
        self.how, self.traceback = how, traceback


class OutOfTime(Exception):
    """A compute process was ended because it took too long."""


class StorageLost(Exception):
    """Database or blobs could not be reached; the engine tries again."""


class ComputeProcess:
    """One process, started when it is first asked, and again after it has ended.

    With `core` it runs on that core alone.
    """

    def __init__(self, parts: Parts, core: int | None = None) -> None:
        self._settings, self._core = parts.settings, core
        self._faults = parts.spool / f"faults-{id(self)}"
        self._process: Any = None
        self._connection: Connection | None = None

    def ask(self, call: str, *arguments: Any) -> Any:
        """Returns the answer of a function of `run_job`. Raises ProcessEnded, OutOfTime,
        StorageLost, and RuntimeError for what the function raised."""
        self.start()
        assert self._connection is not None
        try:
            asked = [open_telemetry.traceparent(), call, *arguments]
            self._connection.send_bytes(json.dumps(asked).encode())
            if not self._connection.poll(self._settings.job_time_limit_s):
                self.close()
                raise OutOfTime
            answer = json.loads(self._connection.recv_bytes())
        except (EOFError, OSError) as error:
            raise self._ended() from error
        if "storage" in answer:
            raise StorageLost(answer["storage"])
        if "raises" in answer:
            raise RuntimeError(answer["raises"])
        return answer["returns"]

    def close(self) -> None:
        """Ends the process."""
        if self._process is not None:
            self._process.kill()
            self._process.join()
            self._process = None

    def start(self) -> None:
        """Starts the process, if it does not run."""
        if self._process is not None and self._process.is_alive():
            return
        ours, theirs = CONTEXT.Pipe()
        self._process = CONTEXT.Process(
            target=_serve,
            args=(
                theirs,
                self._settings,
                self._core,
                self._faults,
                open_telemetry.environment(),
            ),
        )
        self._process.start()
        theirs.close()
        self._connection = ours

    def _ended(self) -> ProcessEnded:
        self._process.join()
        code = self._process.exitcode
        self._process = None
        traceback = self._faults.read_text() if self._faults.is_file() else ""
        lines = "\n".join(traceback.splitlines()[:FAULT_LINES])
        return ProcessEnded(_how_it_ended(code), lines)


class Closable(Protocol):
    """What a pool holds."""

    def close(self) -> None:
        """Ends it; it starts again when it is next asked."""


P = TypeVar("P", bound=Closable)


class Pool(Generic[P]):
    """Some processes, each of which serves one thread at a time."""

    def __init__(self, processes: Sequence[P]) -> None:
        self._free: queue.SimpleQueue[P] = queue.SimpleQueue()
        self._all = tuple(processes)
        for process in processes:
            self._free.put(process)

    @contextmanager
    def one(self) -> Iterator[P]:
        """A process for the block, once one is free."""
        process = self._free.get()
        try:
            yield process
        finally:
            self._free.put(process)

    def close(self) -> None:
        """Ends the processes that are free. One at work stays: nobody may wait for it."""
        for _ in self._all:
            with suppress(queue.Empty):
                process = self._free.get_nowait()
                process.close()
                self._free.put(process)


def _how_it_ended(code: int | None) -> str:
    if code is None or code >= 0:
        return f"its process ended with exit code {code}"
    name = signal.Signals(-code).name
    killed = " (as when memory runs out)" if name == "SIGKILL" else ""
    return f"its process was ended by {name}{killed}"


def _serve(
    connection: Connection,
    settings: Settings,
    core: int | None,
    faults: Path,
    telemetry: dict[str, str],
) -> None:
    """Answers what the worker asks until the worker is gone."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)  # it ends with its worker, not by itself
    asked: queue.SimpleQueue[bytes] = queue.SimpleQueue()
    threading.Thread(target=_listen, args=(connection, asked), daemon=True).start()
    configure_logs(settings.log_level)
    os.environ.update(telemetry)
    open_telemetry.start(WORKER)
    one_arena()
    gc.freeze()  # what was loaded stays, so no collection need look through it
    if core is not None and hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {core})
        cores.cache_clear()
    if settings.job_memory_limit_bytes is not None:
        limit = settings.job_memory_limit_bytes
        resource.setrlimit(resource.RLIMIT_DATA, (limit, limit))
    parts = build(settings)
    parts.queue.prepare()  # a finished job may submit another in its own transaction
    with faults.open("w") as file:
        faulthandler.enable(file)
        while True:
            connection.send_bytes(json.dumps(_answer(parts, asked.get())).encode())


def _listen(connection: Connection, asked: queue.SimpleQueue[bytes]) -> None:
    with suppress(EOFError, OSError):
        while True:
            asked.put(connection.recv_bytes())
    os._exit(0)  # the worker is gone, and what is being computed is not wanted


def _answer(parts: Parts, message: bytes) -> dict[str, Any]:
    from trueup_worker import run_job  # noqa: PLC0415  (the worker itself need not load it)

    trace, call, *arguments = json.loads(message)
    try:
        with open_telemetry.span(call, trace):
            return {"returns": getattr(run_job, call)(parts, *arguments)}
    except SQLAlchemyError as error:
        return {"storage": f"{type(error).__name__}: {error}"}
    except Exception as error:
        log.exception("a call of the worker failed", extra={"call": call})
        return {"raises": f"{type(error).__name__}: {error}"}
