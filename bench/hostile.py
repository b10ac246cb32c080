"""A server under attack: large arrays at once, bodies at once, connections that are held open,
while somebody asks it how it is.

What it costs others is the longest wait of /healthz, beside the same server left alone in the same
run; what it costs the machine is the most memory that the server has ever held.
"""

from __future__ import annotations

import hashlib
import http.client
import socket
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from safetensors.numpy import save

from bench.report import Figure, show
from bench.servers import TOKEN
from tests.http.test_memory import manifest_of, peak_bytes
from tests.support.made import plant_document
from tests.support.service import Service
from tests.support.storage import embedded
from trueup_client import Client

ARRAYS, AT_ONCE, ROUNDS = 100 << 20, 4, 3
BODY, BODIES = 3 << 20, 32
HELD = 450
ALONE_S = 5.0
EVERY_S = 0.02
GROWN = 256 << 20  # bytes that all of it together may add


@dataclass
class Asked:
    """How long /healthz took [s], asked again and again."""

    port: int
    seconds: list[float] = field(default_factory=list)
    refused: int = 0

    def once(self) -> None:
        began = time.perf_counter()
        try:
            with closing(
                http.client.HTTPConnection("127.0.0.1", self.port, timeout=30)
            ) as connection:
                connection.request("GET", "/healthz")
                status = connection.getresponse().status
        except OSError:
            status = 0
        self.refused += status != 200
        self.seconds.append(time.perf_counter() - began)


@contextmanager
def asking(port: int) -> Iterator[Asked]:
    """Somebody who asks all the time."""
    asked, ended = Asked(port), threading.Event()

    def go_on() -> None:
        while not ended.wait(EVERY_S):
            asked.once()

    thread = threading.Thread(target=go_on)
    thread.start()
    try:
        yield asked
    finally:
        ended.set()
        thread.join()


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        service = Service(embedded(Path(folder) / "data"))
        child = service.start_server()
        try:
            figures = _attacked(service, child.pid)
        finally:
            service.stop()
    show("Hostile", figures)


def _attacked(service: Service, pid: int) -> list[Figure]:
    """What each attack cost."""
    with closing(Client(service.url, token=TOKEN)) as client:
        client.register_plant(plant_document("p"))
    arrays = save({"w": np.zeros(ARRAYS // 8)})
    digest, manifest = hashlib.sha256(arrays).hexdigest(), manifest_of(arrays)
    _post(service, "PUT", f"/v1/blobs/{digest}", arrays)
    attacks = {
        "left alone": lambda: time.sleep(ALONE_S),
        f"{AT_ONCE} posts at once of {ARRAYS >> 20} MiB of arrays": lambda: _many(
            lambda: _post(service, "POST", "/v1/plants/p/artifacts", manifest), AT_ONCE, ROUNDS
        ),
        f"{BODIES} bodies at once of {BODY >> 20} MiB": lambda: _many(
            lambda: _post(service, "POST", "/v1/plants", b'{"x": "' + b"y" * BODY), BODIES, ROUNDS
        ),
        f"{HELD} connections held open": lambda: _hold(service.port),
    }
    _post(service, "POST", "/v1/plants/p/artifacts", manifest_of(b"none"))  # loads what that needs
    before, figures = peak_bytes(pid), list[Figure]()
    for what, attack in attacks.items():
        with asking(service.port) as asked:
            attack()
        worst, answered = max(asked.seconds), len(asked.seconds) - asked.refused
        figures.append(
            Figure(f"{what}: longest wait", f"{1e3 * worst:.0f} ms", "< 1000 ms", worst < 1.0)
        )
        figures.append(
            Figure(
                f"{what}: /healthz answered",
                f"{answered} of {len(asked.seconds)}",
                "all",
                not asked.refused,
            )
        )
        grown = peak_bytes(pid) - before
        figures.append(
            Figure(
                f"{what}: memory so far",
                f"+ {grown >> 20} MiB",
                f"< {GROWN >> 20} MiB",
                grown < GROWN,
            )
        )
    return figures


def _post(service: Service, method: str, path: str, body: bytes) -> int:
    headers = {"Authorization": f"Bearer {TOKEN}", "Content-Type": "application/json"}
    with closing(http.client.HTTPConnection("127.0.0.1", service.port, timeout=120)) as connection:
        try:
            connection.request(method, path, body, headers)
            return connection.getresponse().status
        except OSError:
            return 0


def _many(act: Callable[[], int], at_once: int, rounds: int) -> None:
    with ThreadPoolExecutor(at_once) as pool:
        list(pool.map(lambda _: act(), range(at_once * rounds)))


def _hold(port: int) -> None:
    """Connections that send half a head and wait."""
    with ExitStack() as held:
        for _ in range(HELD):
            raw = held.enter_context(socket.create_connection(("127.0.0.1", port)))
            raw.sendall(b"GET /healthz HTTP/1.1\r\nHost: ")
        time.sleep(ALONE_S)
