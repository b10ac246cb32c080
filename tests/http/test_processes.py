"""Several server processes on one port share the storage and the metrics; one that dies is started
again, and all of them end together."""

import os
import re
import signal
import subprocess
import sys
import urllib.request
from pathlib import Path

import pytest

from tests.flow.test_failures import until
from tests.support.made import plant_document
from tests.support.s3 import until_listening
from tests.support.service import ADMIN, ROOT, free_port
from trueup_client import Client

COUNT, REQUESTS = 2, 40


@pytest.fixture
def served(storage):
    """The address of a service of COUNT processes, and the process that supervises them."""
    port = free_port()
    options = ["--port", str(port), "--processes", str(COUNT), "--no-worker"]
    child = subprocess.Popen(
        [sys.executable, "-m", "trueup_cli.main", "serve", *options],
        env={**os.environ, **storage.environment, "TRUEUP_LOG_LEVEL": "ERROR"},
        cwd=ROOT,
    )
    until_listening(port, child)
    url = f"http://127.0.0.1:{port}"
    ask(url, "/healthz")
    yield url, child
    child.kill()
    child.wait()


def ask(url, path):
    request = urllib.request.Request(url + path, headers={"Authorization": f"Bearer {ADMIN}"})
    with urllib.request.urlopen(request, timeout=60) as response:
        return response.read().decode()


def servers_of(pid):
    """The processes that a supervisor has started to serve."""
    found = set()
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            fields = (folder / "stat").read_text().rpartition(")")[2].split()
            command = (folder / "cmdline").read_bytes()
        except OSError:
            continue
        if int(fields[1]) == pid and b"spawn_main" in command:
            found.add(int(folder.name))
    return found


def gone(pids):
    return not any(Path(f"/proc/{pid}").exists() for pid in pids)


def test_they_answer_as_one_and_one_that_dies_is_started_again(served):
    url, supervisor = served
    servers = until(lambda: len(pids := servers_of(supervisor.pid)) == COUNT and pids)
    with Client(url) as client:
        client.register_plant(plant_document("p"))
    for _ in range(REQUESTS):
        assert '"p"' in ask(url, "/v1/plants/p/serving")
    counter = re.compile(
        r'requests_total{method="GET",route="/v1/plants/{plant}/serving",status="200"} (\S+)'
    )
    # a request is counted once it is answered
    until(lambda: float(counter.search(ask(url, "/metrics"))[1]) == REQUESTS)
    killed = servers.pop()
    os.kill(killed, signal.SIGKILL)
    until(lambda: len(servers_of(supervisor.pid) - {killed}) == COUNT)
    assert servers < servers_of(supervisor.pid)
    for _ in range(REQUESTS):
        assert '"p"' in ask(url, "/v1/plants/p/serving")


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_all_of_them_end_with_their_supervisor(served, number):
    _, supervisor = served
    servers = until(lambda: len(pids := servers_of(supervisor.pid)) == COUNT and pids)
    supervisor.send_signal(number)
    supervisor.wait(timeout=60)
    until(lambda: gone(servers))
