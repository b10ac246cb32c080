"""The order of an acknowledgement, as the kernel saw it: bytes on disk, then their name, then the
commit, then the answer."""

import os
import re
import shutil
import signal
import subprocess
from contextlib import closing

import pytest

from tests.flow.test_failures import until
from tests.support.made import episode_bytes, plant_document, save
from tests.support.service import Service
from tests.support.storage import embedded
from trueup_client import Client

CALLS = "fsync,fdatasync,link,linkat,rename,renameat,renameat2,write,writev,sendto,sendmsg"


def strace() -> str:
    """The tracer of system calls, fetched where we may; a test of what is promised is never
    skipped."""
    if shutil.which("strace") is None and os.geteuid() == 0 and shutil.which("apt-get"):
        subprocess.run(
            ["apt-get", "install", "-y", "-qq", "strace"],
            check=False,
            capture_output=True,
            timeout=300,
        )
    return shutil.which("strace") or pytest.fail(
        "strace is needed: install it (Debian: apt-get install strace)"
    )


def calls_of(child, log, act):
    """What a process asked of the kernel while `act` ran, in order."""
    tracer = subprocess.Popen(
        [strace(), "-f", "-y", "-e", f"trace={CALLS}", "-o", str(log), "-p", str(child.pid)],
        stderr=subprocess.PIPE,
    )
    try:
        assert b"attached" in tracer.stderr.readline()
        act()
        until(lambda: "HTTP/1.1 201" in log.read_text(errors="replace"), 20)
    finally:
        tracer.send_signal(signal.SIGINT)
        tracer.wait(timeout=20)
        tracer.stderr.close()
    return log.read_text(errors="replace").splitlines()


def first(lines, pattern, after=-1):
    """The place of the first call of this kind behind another one."""
    found = next(
        (n for n, line in enumerate(lines) if n > after and re.search(pattern, line)), None
    )
    assert found is not None, pattern
    return found


def test_an_upload_is_answered_only_once_its_bytes_its_name_and_its_row_are_on_disk(tmp_path):
    service = Service(embedded(tmp_path / "data"), checkpoint_interval_s=3600)
    child = service.start_server()
    with closing(Client(service.url)) as client:
        client.register_plant(plant_document("p"))
        episode = save(tmp_path, "e.mcap", episode_bytes(1))
        digest = []
        lines = calls_of(
            child,
            tmp_path / "calls",
            lambda: digest.append(client.upload_episode("p", episode)["digest"]),
        )
    service.stop()
    name = digest[0][2:]
    bytes_synced = first(lines, r"(fsync|fdatasync)\(\d+<[^>]*spool[^>]*>")
    named = first(lines, rf"link(at)?\(.*{name}", bytes_synced)
    folder_synced = first(lines, rf"fsync\(\d+<[^>]*blobs/{digest[0][:2]}>", named)
    committed = first(lines, r"(fsync|fdatasync)\(\d+<[^>]*trueup\.sqlite-wal>", folder_synced)
    answered = first(lines, r"HTTP/1\.1 201")
    assert bytes_synced < named < folder_synced < committed < answered
