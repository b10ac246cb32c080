"""Beside: a server with a worker on a data folder, for as long as a command lasts."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

from trueup_cli.show import progress
from trueup_client import Client, Unreachable

START_LIMIT_S, PAUSE_S, STEP_S = 60.0, 0.05, 0.2
LOG_FILE = "service.log"


@contextmanager
def service_beside(
    data: Path, port: int | None = None
) -> Iterator[tuple[str, subprocess.Popen[bytes]]]:
    """Its address and process; its log is `service.log` in the folder. Without a port it takes a
    free one. Raises OSError, Unreachable."""
    with socket.create_server(
        ("127.0.0.1", port or 0)
    ) as free:  # raises where another service listens: it would be taken for ours
        url = f"http://127.0.0.1:{free.getsockname()[1]}"
    data.mkdir(parents=True, exist_ok=True)
    command = [sys.executable, "-m", "trueup_cli.main", "serve", "--port", url.rpartition(":")[2]]
    with (data / LOG_FILE).open("a") as log:
        child = subprocess.Popen(
            command, env={**os.environ, "TRUEUP_DATA_DIR": str(data)}, stderr=log
        )
        ended: list[int] = []

        def end(number: int, _: object) -> None:
            """End as after an error, and the service beside at once, for the error may be lost on
            its way: in a finalizer, say."""
            ended.append(128 + number)
            child.terminate()
            sys.exit(ended[0])

        signal.signal(signal.SIGTERM, end)
        try:
            with progress("starting the service"):
                _wait_until_ready(url, child, data)
            yield url, child
        finally:
            child.terminate()
            child.wait(timeout=START_LIMIT_S)
        if ended:
            sys.exit(ended[0])


def wait(child: subprocess.Popen[bytes]) -> None:
    """Wait until a service beside ends, in steps: a signal that comes just before one long wait
    would go unheard."""
    while child.poll() is None:
        time.sleep(STEP_S)


def _wait_until_ready(url: str, child: subprocess.Popen[bytes], data: Path) -> None:
    deadline = time.monotonic() + START_LIMIT_S
    while time.monotonic() < deadline and child.poll() is None:
        try:
            with closing(Client(url)) as client:
                if client.is_ready() and child.poll() is None:
                    return
        except Unreachable:
            pass
        time.sleep(PAUSE_S)
    said = (
        "another service may be there: give --url with another port, or see"
        if child.poll() is not None
        else "see"
    )
    raise Unreachable(f"the service did not start at {url}; {said} {data / LOG_FILE}")
