"""An S3 server in a process of its own."""

from __future__ import annotations

import socket
import subprocess
import sys
import time
import urllib.request
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

START_LIMIT_S = 60.0


@dataclass(frozen=True)
class S3:
    """A server, by its address."""

    endpoint: str

    def new_bucket(self) -> str:
        """Creates a bucket, and returns its name."""
        name = f"b{uuid.uuid4().hex[:16]}"
        urllib.request.urlopen(
            urllib.request.Request(f"{self.endpoint}/{name}", method="PUT")
        ).close()
        return name


@contextmanager
def start_s3() -> Iterator[S3]:
    """Yields a running server."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    child = subprocess.Popen(
        [sys.executable, "-m", "moto.server", "-p", str(port)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        until_listening(port, child)
        yield S3(f"http://127.0.0.1:{port}")
    finally:
        child.terminate()
        child.wait()


def until_listening(port: int, child: subprocess.Popen) -> None:
    """Waits until a child process listens on a port. Fails if it has ended."""
    deadline = time.monotonic() + START_LIMIT_S
    while time.monotonic() < deadline:
        assert child.poll() is None, f"the server ended with {child.returncode}"
        try:
            socket.create_connection(("127.0.0.1", port), timeout=1).close()
        except OSError:
            time.sleep(0.02)
        else:
            return
    raise AssertionError("the server did not start")
