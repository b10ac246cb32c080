"""What threads that share work take."""

import os
import platform
import subprocess
import sys
import threading

import pytest

from trueup import cores

GROWS = """
import resource
from concurrent.futures import ThreadPoolExecutor
from trueup.cores import one_arena

granted = one_arena() if {asked} else False
small = 100_000  # bytes: larger ones are no arena's

def work(_):
    return [bytearray(small) for _ in range(200)][-1]

with ThreadPoolExecutor(8) as pool:
    kept = list(pool.map(work, range(64)))
with open("/proc/self/maps") as maps:
    print(granted, sum(line.split()[1] == "---p" for line in maps))
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="only glibc has arenas")
def test_threads_take_memory_from_one_arena():
    """What an arena reserves and does not use yet cannot be read or written."""
    said = [
        subprocess.run(
            [sys.executable, "-c", GROWS.format(asked=asked)],
            capture_output=True,
            text=True,
            check=True,
        ).stdout.split()
        for asked in (False, True)
    ]
    assert [granted for granted, _ in said] == ["False", "True"]
    assert int(said[1][1]) < int(said[0][1]) - 4


@pytest.mark.parametrize(
    ("count", "items", "here"), [(1, 3, True), (2, 1, True), (2, 3, False), (2, 0, True)]
)
def test_one_core_or_one_item_needs_no_other_thread(monkeypatch, count, items, here):
    monkeypatch.setattr(cores, "cores", lambda: count)
    mapped = cores.in_parallel(lambda n: (n**2, threading.get_ident()), range(items))
    squares, threads = zip(*mapped, strict=True) if items else ((), ())
    assert squares == tuple(n**2 for n in range(items))
    assert all((thread == threading.get_ident()) is here for thread in threads)


@pytest.mark.parametrize(("asked", "threads"), [(None, "1"), ("2", "2")])
def test_the_command_multiplies_matrices_by_one_thread_unless_it_is_told_otherwise(asked, threads):
    code = "import os, trueup_cli.main; print(os.environ['OPENBLAS_NUM_THREADS'])"
    own = {k: v for k, v in os.environ.items() if k != "OPENBLAS_NUM_THREADS"}
    if asked is not None:
        own["OPENBLAS_NUM_THREADS"] = asked
    command = [sys.executable, "-c", code]
    said = subprocess.run(command, capture_output=True, text=True, check=True, env=own).stdout
    assert said.strip() == threads
