"""Loaded into the process that others are forked from: it survives the death of who asks it.

A process that is killed after it has connected, and before it has said what to fork, makes Python's
fork server end with an EOFError; it then forks for nobody else either. A connection that was
aborted it ignores.
"""

from __future__ import annotations

import errno
import socket
from multiprocessing import reduction

_recvfds = reduction.recvfds


def recvfds(connection: socket.socket, size: int) -> list[int]:
    """Receives file descriptors. Raises ConnectionAbortedError where the peer is gone."""
    try:
        return _recvfds(connection, size)
    except EOFError as error:
        raise ConnectionAbortedError(errno.ECONNABORTED, "the peer is gone") from error


reduction.recvfds = recvfds
