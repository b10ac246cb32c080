"""Run one server process."""

from __future__ import annotations

import socket

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


def serve(parts: Parts, listening: socket.socket) -> None:
    """Serve until told to stop."""
    config = uvicorn.Config(create_app(parts), log_config=None, access_log=False, server_header=False, timeout_graceful_shutdown=10)
    uvicorn.Server(config).run(sockets=[listening])
