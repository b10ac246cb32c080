"""Run one server process."""

from __future__ import annotations

import asyncio
import gc
import logging
import socket
import sys
from contextlib import suppress
from types import FrameType
from typing import cast

import uvicorn

from trueup_service.http.app import create_app
from trueup_service.http.connections import Door, Limits, room_for_connections
from trueup_service.settings import Settings
from trueup_service.wiring import Parts


def listen(host: str, port: int) -> socket.socket:
    """A listening socket with Nagle's algorithm off, since small responses must not wait for an
    acknowledgement.

    Accepted connections inherit the option, whatever event loop and number of processes serve them.
    """
    listening = socket.create_server(
        (host, port), family=socket.AF_INET6 if ":" in host else socket.AF_INET, backlog=2048
    )
    listening.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return listening


# Allocations; a request makes some thousands, nearly all freed without the collector.
COLLECT_AFTER = (20_000, 20, 50)
TICK_S = 1.0  # between looks for slow connections
# A writer that holds a lock after its commit must not wait Python's usual 5 ms for its turn.
SWITCH_INTERVAL_S = 0.0005


def _quiet_collector() -> None:
    """Exclude what was loaded at the start from every garbage collection, which would stall
    requests for tens of milliseconds."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(*COLLECT_AFTER)


class _Server(uvicorn.Server):
    """A server that releases long polls as soon as it is told to stop, and ends slow connections
    while it runs.

    It looks once a second and not ten times, which is most of what an idle server would take.
    """

    def __init__(self, config: uvicorn.Config, door: Door) -> None:
        super().__init__(config)
        self._door = door
        self._exit: asyncio.Event | None = None
        self._loop: asyncio.AbstractEventLoop | None = None

    async def main_loop(self) -> None:
        self._loop, self._exit = asyncio.get_running_loop(), asyncio.Event()
        while not await self.on_tick(0):  # tick 0 is the one that renews the header `date`
            self._door.sweep(self.server_state.connections, self._loop.time())
            with suppress(TimeoutError):
                await asyncio.wait_for(self._exit.wait(), TICK_S)

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        answers = getattr(self.config.app.state, "answers", None)  # type: ignore[union-attr]
        if answers is not None:
            answers.closing = True
        super().handle_exit(sig, frame)
        if self._loop is not None and self._exit is not None:
            self._loop.call_soon_threadsafe(self._exit.set)


def _limits(settings: Settings) -> Limits:
    connections = settings.connections or room_for_connections(settings.database_pool)
    return Limits(
        settings.header_limit_s, settings.keep_alive_s, settings.silence_limit_s, connections
    )


def serve(parts: Parts, listening: socket.socket) -> None:
    """Serve until told to stop."""
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    _quiet_collector()
    door = Door(_limits(parts.settings))
    logging.getLogger("trueup").info("at the door", extra={"connections": door.limits.connections})
    config = uvicorn.Config(
        create_app(parts),
        log_config=None,
        access_log=False,
        server_header=False,
        http=cast(type[asyncio.Protocol], door.protocol),
        ws="none",
        timeout_keep_alive=int(parts.settings.keep_alive_s) + 1,
        timeout_graceful_shutdown=10,
    )
    _Server(config, door).run(sockets=[listening])
