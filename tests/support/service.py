"""A service as its users run it: processes of servers and workers, which can be killed."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from tests.support.forks import Forked, run
from tests.support.s3 import until_listening
from tests.support.storage import Storage

ADMIN = "an-admins-token-that-the-tests-know"
ROOT = Path(__file__).parent.parent.parent


def free_port() -> int:
    """Returns a port that nobody listens on."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        return int(free.getsockname()[1])


class Service:
    """A server and workers on one storage, with settings such as `long_poll_limit_s=1`."""

    def __init__(self, storage: Storage, **settings: object) -> None:
        self.storage = storage
        self._settings = {f"TRUEUP_{name.upper()}": str(value) for name, value in settings.items()}
        self.port = free_port()
        self._children: list[Forked] = []
        self._workers: list[Forked] = []

    @property
    def url(self) -> str:
        """The server's address."""
        return f"http://127.0.0.1:{self.port}"

    @property
    def workers(self) -> list[Forked]:
        """The workers that run."""
        return [worker for worker in self._workers if worker.returncode is None]

    @contextmanager
    def running(self, worker: bool = True, kept: bool = False) -> Iterator[Service]:
        """Runs a server and a worker. If `kept`, the server starts the worker, and restarts it."""
        try:
            self.start_server(worker, kept=kept)
            yield self
        finally:
            self.stop()

    def start_server(
        self, worker: bool = False, module: str = "trueup_cli.main", *, kept: bool = False
    ) -> Forked:
        """Starts a server and waits until it listens; with `kept` it has a worker of its own."""
        child = self._start(
            module, "serve", "--port", str(self.port), *([] if kept else ["--no-worker"])
        )
        until_listening(self.port, child)
        if worker and not kept:
            self.start_worker()
        return child

    def start_worker(self, module: str = "trueup_cli.main") -> Forked:
        """Starts a worker."""
        worker = self._start(module, "work")
        self._workers.append(worker)
        return worker

    def stop(self, children: Sequence[Forked] | None = None) -> None:
        """Stops all processes, or some of them."""
        stopped = list(self._children if children is None else children)
        for child in stopped:
            child.terminate()
        for child in stopped:
            child.wait(timeout=30)
        self._children = [child for child in self._children if child not in stopped]

    def _start(self, module: str, *arguments: str) -> Forked:
        quiet = {
            "TRUEUP_LOG_LEVEL": "WARNING",
            "PYTHONWARNINGS": "default",
            "TRUEUP_JOB_POLL_INTERVAL_S": "0.3",
        }
        environment = {**os.environ, **self.storage.environment, **quiet, **self._settings}
        child = Forked(module, arguments, environment, ROOT)
        self._children.append(child)
        return child


def kill(child: Forked) -> None:
    """Kills a process with SIGKILL, and waits for its end."""
    child.send_signal(signal.SIGKILL)
    child.wait()


def command(service: Service, *arguments: str, check: bool = True) -> subprocess.CompletedProcess:
    """Runs the `trueup` command against a service."""
    environment = {
        **os.environ,
        "TRUEUP_URL": service.url,
        "TRUEUP_ACTOR": "commander",
        "XDG_STATE_HOME": service.storage.environment["TRUEUP_DATA_DIR"],
        "COLUMNS": "200",
        "NO_COLOR": "1",
    }
    done = run("trueup_cli.main", arguments, environment, ROOT)
    assert not check or done.returncode == 0, done.stderr
    return done
