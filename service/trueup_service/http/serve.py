"""Run one server process, or several."""

from __future__ import annotations

import asyncio
import gc
import logging
import os
import signal
import socket
import sys
import tempfile
import threading
from contextlib import suppress
from multiprocessing import parent_process
from types import FrameType
from typing import cast

import uvicorn
from uvicorn.supervisors import multiprocess

from trueup_service import open_telemetry
from trueup_service.http.app import create_app
from trueup_service.http.connections import Door, Limits, room_for_connections
from trueup_service.http.request_telemetry import SHARED_METRICS
from trueup_service.logs import configure_logs
from trueup_service.settings import Settings
from trueup_service.wiring import Parts, build


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
    """A server that ends long polls and streams as soon as it is told to stop, and slow connections
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
            live = getattr(self.config.app.state, "live", None)  # type: ignore[union-attr]
            if live is not None:
                self._loop.call_soon_threadsafe(live.close)


def _limits(settings: Settings) -> Limits:
    connections = settings.connections or room_for_connections(settings.database_pool)
    return Limits(
        settings.header_limit_s, settings.keep_alive_s, settings.silence_limit_s, connections
    )


def serve(parts: Parts, listening: socket.socket) -> None:
    """Serve until told to stop."""
    _server(parts).run(sockets=[listening])


def serve_by_processes(settings: Settings, listening: socket.socket, count: int) -> None:
    """Serve by so many processes until told to stop. They share one socket and one storage, and one
    that dies is started again."""
    with tempfile.TemporaryDirectory(prefix="trueup-metrics-") as metrics:
        os.environ[SHARED_METRICS] = metrics  # read by prometheus_client when it is imported
        config = _ConfigOfProcess("trueup_service.http.serve", workers=count, log_config=None)
        config.settings = settings
        # the supervisor takes its class of process from its module alone
        multiprocess.Process = _Process  # type: ignore[misc]
        multiprocess.Multiprocess(config, [listening]).run()


class _ConfigOfProcess(uvicorn.Config):
    """What the supervisor passes on to a process: the settings, from which that builds the rest."""

    settings: Settings


class _Process(multiprocess.Process):
    """One of several server processes, under uvicorn's supervisor."""

    config: _ConfigOfProcess

    @property
    def server(self) -> uvicorn.Server:
        if self._server is None:
            configure_logs(self.config.settings.log_level)
            self._server = _server(build(self.config.settings))
        return self._server

    def target(self, sockets: list[socket.socket] | None = None) -> None:
        # the supervisor asks at once, from another thread, whether the server has started
        assert self.server
        threading.Thread(target=_end_with_parent, daemon=True).start()
        super().target(sockets)


def _end_with_parent() -> None:
    parent = parent_process()
    assert parent is not None
    parent.join()
    os.kill(os.getpid(), signal.SIGTERM)  # as the supervisor, which was killed, would have told it


def _server(parts: Parts) -> _Server:
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    open_telemetry.start("trueup-server")
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
    return _Server(config, door)
