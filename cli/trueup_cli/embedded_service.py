"""An embedded service: a server with a worker on a data folder, while a command runs."""

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

START_LIMIT_S, READY_POLL_S, WAIT_STEP_S = 60.0, 0.05, 0.2
LOG_FILE = "service.log"


@contextmanager
def embedded_service(
    data: Path, port: int | None = None
) -> Iterator[tuple[str, subprocess.Popen[bytes]]]:
    """Starts a service and yields its address and process; ends it after the block.

    Its log is `service.log` in the folder. Without a port it takes a free one. Raises OSError if
    another process listens on the port, and Unreachable if the service does not start.
    """
    # raises if another service listens there, which would be mistaken for ours
    with socket.create_server(("127.0.0.1", port or 0)) as free:
        url = f"http://127.0.0.1:{free.getsockname()[1]}"
    data.mkdir(parents=True, exist_ok=True)
    command = [sys.executable, "-m", "trueup_cli.main", "serve", "--port", url.rpartition(":")[2]]
    with (data / LOG_FILE).open("a") as log:
        child = subprocess.Popen(
            command, env={**os.environ, "TRUEUP_DATA_DIR": str(data)}, stderr=log
        )
        ended: list[int] = []

        def end(number: int, _: object) -> None:
            """Exits as after an error, and ends the service at once.

            The exception may be lost on its way, for example in a finalizer.
            """
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


def admin_token(data: Path) -> str:
    """The token of an embedded service's first admin: the one that is set, else that of its
    folder."""
    return os.environ.get("TRUEUP_ADMIN_TOKEN") or (data / "admin.token").read_text().strip()


def wait_until_ended(child: subprocess.Popen[bytes]) -> None:
    """Waits until a service ends.

    It waits in steps, because a signal that comes just before one long wait would go unheard.
    """
    while child.poll() is None:
        time.sleep(WAIT_STEP_S)


def _wait_until_ready(url: str, child: subprocess.Popen[bytes], data: Path) -> None:
    deadline = time.monotonic() + START_LIMIT_S
    while time.monotonic() < deadline and child.poll() is None:
        try:
            with closing(Client(url)) as client:
                if client.is_ready() and child.poll() is None:
                    return
        except Unreachable:
            pass
        time.sleep(READY_POLL_S)
    advice = (
        "another service may be there: give --url with another port, or see"
        if child.poll() is not None
        else "see"
    )
    raise Unreachable(f"the service did not start at {url}; {advice} {data / LOG_FILE}")
