"""Ours and the peer registry, each as its users start it."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import time
import urllib.request
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

ROOT = Path(__file__).parent.parent
PEER = ROOT / "build" / "peer"
TICKS = os.sysconf("SC_CLK_TCK")
PEER_PACKAGE = "mlflow>=3.17,<4"


TOKEN = os.environ["TRUEUP_TOKEN"] = os.environ["TRUEUP_ADMIN_TOKEN"] = (
    "an-admins-token-that-the-bench-knows"
)


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
def ours(
    data: Path,
    worker: bool = False,
    module: str = "trueup_cli.main",
    arguments: Sequence[str] = (),
    **environment: str,
) -> Iterator[tuple[int, subprocess.Popen, float]]:
    """Port, process and time to the first answer [s]."""
    port = free_port()
    command = [
        sys.executable,
        "-m",
        module,
        "serve",
        "--port",
        str(port),
        *arguments,
        *([] if worker else ["--no-worker"]),
    ]
    began = time.perf_counter()
    child = subprocess.Popen(
        command,
        env={**os.environ, "TRUEUP_DATA_DIR": str(data), **environment},
        cwd=ROOT,
        stderr=subprocess.DEVNULL,
    )
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
        [
            str(ROOT / ".venv/bin/uv"),
            "pip",
            "install",
            "--quiet",
            "--python",
            str(PEER / "bin/python"),
            PEER_PACKAGE,
        ],
        check=True,
    )


class Peer:
    """The running peer. It is stopped while ours is measured: even at rest its processes take a
    share of the cores."""

    def __init__(self, port: int, group: int, start_s: float) -> None:
        self.port, self._group, self.start_s = port, group, start_s

    @contextmanager
    def awake(self) -> Iterator[int]:
        """The peer runs; its port."""
        os.killpg(self._group, signal.SIGCONT)
        try:
            yield self.port
        finally:
            os.killpg(self._group, signal.SIGSTOP)


@contextmanager
def peer(data: Path, workers: int = 1) -> Iterator[Peer]:
    """The peer on SQLite and a folder, asleep until it is measured."""
    install_peer()
    port = free_port()
    data.mkdir(parents=True)
    store = [
        "--backend-store-uri",
        f"sqlite:///{data}/peer.db",
        "--artifacts-destination",
        str(data / "artifacts"),
    ]
    command = [
        str(PEER / "bin/mlflow"),
        "server",
        *store,
        "--port",
        str(port),
        "--workers",
        str(workers),
    ]
    began = time.perf_counter()
    child = subprocess.Popen(
        command,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        cwd=data,
        start_new_session=True,
    )
    try:
        first_200(f"http://127.0.0.1:{port}/health", child)
        started = time.perf_counter() - began
        os.killpg(child.pid, signal.SIGSTOP)
        yield Peer(port, child.pid, started)
    finally:
        os.killpg(child.pid, signal.SIGCONT)
        os.killpg(child.pid, signal.SIGTERM)
        child.wait()


def call(port: int, method: str, path: str, body: object = None) -> dict:
    """One JSON request."""
    data = None if body is None else json.dumps(body).encode()
    headers = {"Content-Type": "application/json", "Authorization": f"Bearer {TOKEN}"}
    request = urllib.request.Request(
        f"http://127.0.0.1:{port}{path}", method=method, data=data, headers=headers
    )
    with urllib.request.urlopen(request) as answer:
        return json.load(answer)


def resident_mib(pid: int) -> float:
    """Resident memory of a process [MiB]."""
    status = Path(f"/proc/{pid}/status").read_text()
    return int(status.split("VmRSS:")[1].split()[0]) / 1024


def descendants(pid: int) -> list[int]:
    """The processes that a process has started, and those that they have."""
    parents = {}
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = stat.read_text().rpartition(")")[2].split()
        except OSError:
            continue
        parents[int(stat.parent.name)] = int(fields[1])
    found, layer = [], [pid]
    while layer:
        layer = [child for child, parent in parents.items() if parent in layer]
        found += layer
    return found


def cpu_s(pids: list[int]) -> float:
    """What processes have used of the cores, and those of their children that have ended [s]."""
    total = 0
    for pid in pids:
        try:
            fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        except OSError:
            continue  # it has ended, and its parent counts it
        total += sum(map(int, fields[11:15]))
    return total / TICKS
