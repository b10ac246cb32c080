"""A line to a server that can be cut, mended, slowed down, or answer 503 for it."""

from __future__ import annotations

import contextlib
import socket
import threading
import time

AWAY = b"HTTP/1.1 503 Slow Down\r\nContent-Length: 0\r\nConnection: close\r\n\r\n"


class Line:
    """Passes bytes on to a port of this machine."""

    def __init__(self, port: int) -> None:
        self._to, self.state, self.delay_s, self.carried = port, "up", 0.0, 0
        self._open: set[socket.socket] = set()
        self._listening = socket.create_server(("127.0.0.1", 0))
        self.port = self._listening.getsockname()[1]
        threading.Thread(target=self._accept, daemon=True).start()

    def set(self, state: str) -> None:
        """`up`, `down` (every connection breaks), or `away` (every request is answered 503)."""
        self.state = state
        for line in list(self._open) if state != "up" else ():
            self._close(line)

    def close(self) -> None:
        self.set("down")
        self._listening.close()

    def _accept(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                line, _ = self._listening.accept()
                threading.Thread(target=self._serve, args=(line,), daemon=True).start()

    def _serve(self, line: socket.socket) -> None:
        if self.state == "down":
            line.close()
            return
        if self.state == "away":
            with contextlib.suppress(OSError):
                line.recv(1 << 16)
                line.sendall(AWAY)
            line.close()
            return
        try:
            other = socket.create_connection(("127.0.0.1", self._to))
        except OSError:
            line.close()
            return
        self._open |= {line, other}
        back = threading.Thread(target=self._pass, args=(other, line), daemon=True)
        back.start()
        self._pass(line, other)

    def _pass(self, source: socket.socket, to: socket.socket) -> None:
        with contextlib.suppress(OSError):
            while part := source.recv(1 << 16):
                self.carried += len(part)
                time.sleep(self.delay_s)
                to.sendall(part)
        self._close(source)
        self._close(to)

    def _close(self, line: socket.socket) -> None:
        self._open.discard(line)
        with contextlib.suppress(OSError):
            line.shutdown(socket.SHUT_RDWR)
        line.close()
