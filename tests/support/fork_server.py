"""Loaded into the process that others are forked from, as the last of what it loads.

It loads the compiled rollouts, and all of ours but the command, which reads the environment when it
is loaded: what is forked begins with them, and no garbage collection looks at them.

It survives the death of who asks it. A process that is killed after it has connected, and before it
has said what to fork, makes Python's fork server end with an EOFError; it then forks for nobody
else either. A connection that was aborted it ignores.
"""

from __future__ import annotations

import errno
import gc
import importlib
import pkgutil
import socket
from multiprocessing import reduction

from trueup.fit.fitter import warm
from trueup.model.family_kernel import compile_all

OURS = ("trueup", "trueup_client", "trueup_pages", "trueup_service", "trueup_worker")

for _package in OURS:
    for _module in pkgutil.walk_packages(
        importlib.import_module(_package).__path__, f"{_package}."
    ):
        importlib.import_module(_module.name)
compile_all()
warm()
gc.collect()
gc.freeze()

_recvfds = reduction.recvfds


def recvfds(connection: socket.socket, size: int) -> list[int]:
    """Receives file descriptors. Raises ConnectionAbortedError where the peer is gone."""
    try:
        return _recvfds(connection, size)
    except EOFError as error:
        raise ConnectionAbortedError(errno.ECONNABORTED, "the peer is gone") from error


reduction.recvfds = recvfds
