"""Run one server process."""

from __future__ import annotations

import gc
import socket
import sys
from types import FrameType

import uvicorn

from trueup_service.http.app import create_app
from trueup_service.wiring import Parts


def listen(host: str, port: int) -> socket.socket:
    """A listening socket with Nagle's algorithm off: small answers must not wait for the other side's acknowledgement.

    Accepted connections inherit the option, whatever event loop and number of processes serve them.
    """
    found = socket.create_server((host, port), family=socket.AF_INET6 if ":" in host else socket.AF_INET, backlog=2048)
    found.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return found


COLLECT_AFTER = (20_000, 20, 50)  # allocations; a request makes some thousands, nearly all freed without the collector
KEEP_ALIVE_S = 75  # a robot that asks twice a minute keeps its connection; uvicorn's 5 s would make it connect again for each answer
SWITCH_INTERVAL_S = 0.0005  # a writer back from its commit must not wait Python's usual 5 ms for its turn, with a lock in its hands


def _quiet_collector() -> None:
    """Leave what was loaded at the start out of every garbage collection: looking through it stalls requests for tens of ms."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(*COLLECT_AFTER)


class _Server(uvicorn.Server):
    """Lets those who wait for a change go as soon as it is told to stop, instead of waiting for them."""

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        answers = getattr(self.config.app.state, "answers", None)  # type: ignore[union-attr]
        if answers is not None:
            answers.closing = True
        super().handle_exit(sig, frame)


def serve(parts: Parts, listening: socket.socket) -> None:
    """Serve until told to stop."""
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    _quiet_collector()
    config = uvicorn.Config(
        create_app(parts),
        log_config=None,
        access_log=False,
        server_header=False,
        timeout_keep_alive=KEEP_ALIVE_S,
        timeout_graceful_shutdown=10,
    )
    _Server(config).run(sockets=[listening])
