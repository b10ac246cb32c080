"""A TCP proxy to a server, which can break or slow down connections, or answer 503 itself."""

from __future__ import annotations

import contextlib
import socket
import threading
import time

AWAY = b"HTTP/1.1 503 Slow Down\r\nContent-Length: 0\r\nConnection: close\r\n\r\n"


class TcpProxy:
    """Passes bytes on to a port of this machine. `carried` counts them."""

    def __init__(self, port: int) -> None:
        self._target, self.state, self.delay_s, self.carried = port, "up", 0.0, 0
        self._open: set[socket.socket] = set()
        self._listening = socket.create_server(("127.0.0.1", 0))
        self.port = self._listening.getsockname()[1]
        threading.Thread(target=self._accept, daemon=True).start()

    def set(self, state: str) -> None:
        """Sets the state: `up`, `down` (connections break), or `away` (requests get a 503)."""
        self.state = state
        for connection in list(self._open) if state != "up" else ():
            self._close(connection)

    def close(self) -> None:
        """Breaks every connection, and stops listening."""
        self.set("down")
        self._listening.close()

    def _accept(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                connection, _ = self._listening.accept()
                threading.Thread(target=self._serve, args=(connection,), daemon=True).start()

    def _serve(self, connection: socket.socket) -> None:
        if self.state == "down":
            connection.close()
            return
        if self.state == "away":
            with contextlib.suppress(OSError):
                connection.recv(1 << 16)
                connection.sendall(AWAY)
            connection.close()
            return
        try:
            other = socket.create_connection(("127.0.0.1", self._target))
        except OSError:
            connection.close()
            return
        self._open |= {connection, other}
        back = threading.Thread(target=self._pass, args=(other, connection), daemon=True)
        back.start()
        self._pass(connection, other)

    def _pass(self, source: socket.socket, to: socket.socket) -> None:
        with contextlib.suppress(OSError):
            while part := source.recv(1 << 16):
                self.carried += len(part)
                time.sleep(self.delay_s)
                to.sendall(part)
        self._close(source)
        self._close(to)

    def _close(self, connection: socket.socket) -> None:
        self._open.discard(connection)
        with contextlib.suppress(OSError):
            connection.shutdown(socket.SHUT_RDWR)
        connection.close()
