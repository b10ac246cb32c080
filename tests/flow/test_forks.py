"""What the tests fork their services from."""

import os
import socket
import sys
from multiprocessing import forkserver
from pathlib import Path

from tests.support.forks import run


def test_it_goes_on_when_who_asks_it_dies():
    """A worker is killed at any moment, and others are forked from the same process."""
    server = forkserver._forkserver
    server.ensure_running()
    asked = server._forkserver_pid
    with socket.socket(socket.AF_UNIX) as client:
        client.connect(server._forkserver_address)
    ended = run("platform", [], dict(os.environ), Path.cwd())
    assert (ended.returncode, ended.stderr) == (0, "")
    assert sys.platform in ended.stdout.lower()
    assert server._forkserver_pid == asked
