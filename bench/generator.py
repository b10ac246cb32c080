"""A load generator: one thread, many connections, each sending its next request when its answer is
whole."""

from __future__ import annotations

import heapq
import selectors
import socket
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from bench.servers import TOKEN

LATEST_S = 30.0  # after the end, for answers that are still due


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
        return (
            f"{self.rate:8.0f} req/s   p50 {self.quantile_ms(0.5):7.2f} ms   p99 "
            f"{self.quantile_ms(0.99):7.2f} ms   {self.statuses}"
        )


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
    more = "".join(
        f"{k.replace('_', '-')}: {v}\r\n"
        for k, v in {"Authorization": f"Bearer {TOKEN}", **headers}.items()
    )
    return f"GET {path} HTTP/1.1\r\nHost: 127.0.0.1\r\n{more}\r\n".encode()


def send(
    method: str, path: str, body: bytes, kind: str = "application/json", token: str = TOKEN
) -> bytes:
    """A request with a body."""
    head = f"{method} {path} HTTP/1.1\r\nHost: 127.0.0.1\r\nAuthorization: Bearer {token}\r\n"
    return f"{head}Content-Type: {kind}\r\nContent-Length: {len(body)}\r\n\r\n".encode() + body


def run(ports: int | Sequence[int], streams: Sequence[Iterator[bytes]], seconds: float) -> Load:
    """Send each stream on a connection of its own, to its own port where several are given, until
    it ends or the time is over."""
    load, ready = Load(), selectors.DefaultSelector()
    began = time.perf_counter()
    for port, stream in zip(
        [ports] * len(streams) if isinstance(ports, int) else ports, streams, strict=True
    ):
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


@dataclass(frozen=True)
class Asked:
    """A request of a kind that is due so long after the beginning [s]."""

    due_s: float
    kind: str
    request: bytes


def pace(
    clients: Sequence[tuple[int, Iterator[Asked]]], seconds: float, look: Callable[[], None]
) -> dict[str, Load]:
    """Send what each client asks of its port when it is due, one request at a time on a connection
    of its own; loads by kind.

    A latency is counted from when the request was due, so that a slow answer is not hidden by what
    had to wait for it. `look` is called once a second.
    """
    loads: dict[str, Load] = {}
    ready, waiting = selectors.DefaultSelector(), []
    sending = [_Paced(port, asks) for port, asks in clients]
    began = looked = time.perf_counter()
    for number, client in enumerate(sending):
        if (due := client.advance()) is not None:
            heapq.heappush(waiting, (due, number))
    while waiting or ready.get_map():
        now = time.perf_counter() - began
        if now > seconds + LATEST_S:
            break
        if time.perf_counter() - looked > 1.0:
            looked = time.perf_counter()
            look()
        while waiting and waiting[0][0] <= min(now, seconds):
            _, number = heapq.heappop(waiting)
            sending[number].connection.send()
            ready.register(sending[number].connection.socket, selectors.EVENT_READ, number)
        if waiting and waiting[0][0] > seconds and not ready.get_map():
            break
        for key, _ in ready.select(
            timeout=max(0.0, min(waiting[0][0] - now, 0.5)) if waiting else 0.5
        ):
            client = sending[key.data]
            load = loads.setdefault(client.asked.kind, Load(seconds))
            if client.connection.receive(load):
                load.latencies[-1] = time.perf_counter() - began - client.asked.due_s
                ready.unregister(client.connection.socket)
                if (due := client.advance()) is not None:
                    heapq.heappush(waiting, (due, key.data))
    for client in sending:
        client.connection.socket.close()
    ready.close()
    return loads


class _Paced:
    """A client and what it asks next."""

    def __init__(self, port: int, asks: Iterator[Asked]) -> None:
        self._asks, self.asked = asks, Asked(0.0, "", b"")
        self.connection = _Connection(port, iter(lambda: self.asked.request, None))

    def advance(self) -> float | None:
        """When the next request is due [s]; None after the last."""
        found = next(self._asks, None)
        if found is not None:
            self.asked = found
        return None if found is None else found.due_s


def forever(request: bytes) -> Iterator[bytes]:
    """The same request again and again."""
    while True:
        yield request
