"""A load generator: one thread, many connections, each sending its next request when its answer is whole."""

from __future__ import annotations

import selectors
import socket
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from bench.servers import TOKEN


@dataclass
class Load:
    """Latencies [s] of the answers that came, and how many had each status."""

    seconds: float = 0.0
    latencies: list[float] = field(default_factory=list)
    statuses: dict[int, int] = field(default_factory=dict)

    @property
    def rate(self) -> float:
        return len(self.latencies) / self.seconds

    def quantile_ms(self, q: float) -> float:
        return 1e3 * float(np.quantile(self.latencies, q))

    def line(self) -> str:
        return f"{self.rate:8.0f} req/s   p50 {self.quantile_ms(0.5):7.2f} ms   p99 {self.quantile_ms(0.99):7.2f} ms   {self.statuses}"


class _Connection:
    def __init__(self, port: int, requests: Iterator[bytes]) -> None:
        self.socket = socket.create_connection(("127.0.0.1", port))
        self.socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._requests, self._received, self._needed, self._sent_at = requests, b"", -1, 0.0

    def send(self) -> bool:
        request = next(self._requests, None)
        if request is None:
            return False
        self._received, self._needed, self._sent_at = b"", -1, time.perf_counter()
        self.socket.sendall(request)
        return True

    def receive(self, load: Load) -> bool:
        """Whether the answer is whole."""
        part = self.socket.recv(1 << 20)
        if not part:
            raise ConnectionError("the server closed the connection")
        self._received += part
        if self._needed < 0 and (end := self._received.find(b"\r\n\r\n")) >= 0:
            head = self._received[:end].lower()
            at = head.find(b"content-length:")
            self._needed = end + 4 + (int(head[at + 15 :].split(b"\r\n")[0]) if at >= 0 else 0)
        if self._needed < 0 or len(self._received) < self._needed:
            return False
        load.latencies.append(time.perf_counter() - self._sent_at)
        status = int(self._received[9:12])
        load.statuses[status] = load.statuses.get(status, 0) + 1
        return True


def get(path: str, **headers: str) -> bytes:
    """A GET request's bytes."""
    more = "".join(f"{k.replace('_', '-')}: {v}\r\n" for k, v in {"Authorization": f"Bearer {TOKEN}", **headers}.items())
    return f"GET {path} HTTP/1.1\r\nHost: 127.0.0.1\r\n{more}\r\n".encode()


def send(method: str, path: str, body: bytes, kind: str = "application/json") -> bytes:
    """A request with a body."""
    head = f"{method} {path} HTTP/1.1\r\nHost: 127.0.0.1\r\nAuthorization: Bearer {TOKEN}\r\n"
    return f"{head}Content-Type: {kind}\r\nContent-Length: {len(body)}\r\n\r\n".encode() + body


def run(port: int, streams: Sequence[Iterator[bytes]], seconds: float) -> Load:
    """Send each stream on a connection of its own until it ends or the time is over."""
    load, ready = Load(), selectors.DefaultSelector()
    began = time.perf_counter()
    for stream in streams:
        connection = _Connection(port, stream)
        if connection.send():
            ready.register(connection.socket, selectors.EVENT_READ, connection)
    while ready.get_map() and time.perf_counter() - began < seconds:
        for key, _ in ready.select(timeout=0.5):
            connection: _Connection = key.data
            if connection.receive(load) and not connection.send():
                ready.unregister(connection.socket)
                connection.socket.close()
    load.seconds = time.perf_counter() - began
    for key in list(ready.get_map().values()):
        key.data.socket.close()
    ready.close()
    return load


def forever(request: bytes) -> Iterator[bytes]:
    """The same request again and again."""
    while True:
        yield request
