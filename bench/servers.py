"""Ours and the peer registry, each as its users start it."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
import time
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

ROOT = Path(__file__).parent.parent
PEER = ROOT / "build" / "peer"
PEER_PACKAGE = "mlflow>=3.17,<4"


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as found:
        return int(found.getsockname()[1])


def first_200(url: str, child: subprocess.Popen, limit_s: float = 90.0) -> None:
    """Wait for the first good answer, looking every 5 ms."""
    deadline = time.monotonic() + limit_s
    while time.monotonic() < deadline:
        assert child.poll() is None, "the server ended"
        try:
            with urllib.request.urlopen(url, timeout=5) as answer:
                if answer.status == 200:
                    return
        except OSError:
            time.sleep(0.005)
    raise AssertionError(f"{url} never answered 200")


@contextmanager
def ours(data: Path, worker: bool = False, **environment: str) -> Iterator[tuple[int, subprocess.Popen, float]]:
    """Port, process and time to the first answer [s]."""
    port = free_port()
    command = [sys.executable, "-m", "trueup_cli.main", "serve", "--port", str(port), *([] if worker else ["--no-worker"])]
    began = time.perf_counter()
    child = subprocess.Popen(command, env={**os.environ, "TRUEUP_DATA_DIR": str(data), **environment}, cwd=ROOT)
    try:
        first_200(f"http://127.0.0.1:{port}/healthz", child)
        yield port, child, time.perf_counter() - began
    finally:
        child.terminate()
        child.wait()


def install_peer() -> None:
    """The peer in an environment of its own."""
    if (PEER / "bin" / "mlflow").exists():
        return
    print("installing the peer registry into build/peer …", flush=True)
    subprocess.run([sys.executable, "-m", "venv", str(PEER)], check=True)
    subprocess.run(
        [str(ROOT / ".venv/bin/uv"), "pip", "install", "--quiet", "--python", str(PEER / "bin/python"), PEER_PACKAGE], check=True
    )


@contextmanager
def peer(data: Path, workers: int = 1) -> Iterator[tuple[int, float]]:
    """Port and time to the first answer [s] of the peer, on SQLite and a folder."""
    install_peer()
    port = free_port()
    data.mkdir(parents=True)
    arguments = [
        "--backend-store-uri",
        f"sqlite:///{data}/peer.db",
        "--artifacts-destination",
        str(data / "artifacts"),
        "--port",
        str(port),
        "--workers",
        str(workers),
    ]
    began = time.perf_counter()
    child = subprocess.Popen(
        [str(PEER / "bin/mlflow"), "server", *arguments],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        cwd=data,
        start_new_session=True,
    )
    try:
        first_200(f"http://127.0.0.1:{port}/health", child)
        yield port, time.perf_counter() - began
    finally:
        os.killpg(child.pid, 15)
        child.wait()


def call(port: int, method: str, path: str, body: object = None) -> dict:
    """One JSON request."""
    data = None if body is None else json.dumps(body).encode()
    request = urllib.request.Request(
        f"http://127.0.0.1:{port}{path}", method=method, data=data, headers={"Content-Type": "application/json"}
    )
    with urllib.request.urlopen(request) as answer:
        return json.load(answer)


def resident_mib(pid: int) -> float:
    """Resident memory of a process [MiB]."""
    status = Path(f"/proc/{pid}/status").read_text()
    return int(status.split("VmRSS:")[1].split()[0]) / 1024
