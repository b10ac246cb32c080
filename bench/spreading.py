"""A blind trial on one worker and on several: how long it takes, and that the cases are shared.

As many workers as cores diagnose, each with a core of its own. More workers than cores sleep for as
long as a diagnosis took, so that what the engine and the job itself add is measured with four.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from bench.report import Figure, show
from bench.servers import ROOT, TOKEN, ours
from tests.support.case import write_recordings
from tests.support.simulated import recorded_twice
from trueup_client import Client

TRIALS = int(os.environ.get("TRIALS", "60"))
CORES = sorted(os.sched_getaffinity(0))
SLEEPING = 4
PINNED = """
import os, runpy, sys
os.sched_setaffinity(0, {int(sys.argv.pop(1))})
runpy.run_module("trueup_cli.main", run_name="__main__")
"""
SLEEPER = """
import os, runpy, sys, time
os.sched_setaffinity(0, {int(sys.argv.pop(1))})
slept_s = float(sys.argv.pop(1))
import orjson
import trueup_worker.computing as computing
from trueup_service.wiring import keep_bytes
def diagnose_case(parts, process, asked):
    time.sleep(slept_s)
    return keep_bytes(parts, orjson.dumps({"problem": "slept", "seconds": slept_s}))
computing.diagnose_case = diagnose_case
runpy.run_module("trueup_cli.main", run_name="__main__")
"""


def main() -> None:
    with tempfile.TemporaryDirectory() as folder, ours(Path(folder) / "data") as (port, _, _):
        plant, episodes, _ = recorded_twice("A1", ["quadratic_drag"], 21)
        files = write_recordings(Path(folder), episodes)
        with Client(f"http://127.0.0.1:{port}", token=TOKEN) as client:
            client.register_plant(dict(plant.document))
            for file in files:
                client.upload_episode(plant.name, file)
            real = {}
            for count in (1, len(CORES)):
                with workers(Path(folder) / "data", PINNED, count):
                    real[count] = trial(client, plant.name)
            seconds = [row["seconds"] for row in real[1][1]["rows"]]
            slept = {}
            for count in (1, SLEEPING):
                with workers(Path(folder) / "data", SLEEPER, count, f"{np.mean(seconds):.3f}"):
                    slept[count] = trial(client, plant.name)[0]
    one, all_ = real[1][0], real[len(CORES)][0]
    show(
        f"spreading: a blind trial of {TRIALS} machines",
        [
            Figure("one worker on one core", f"{one:.1f} s"),
            Figure("… of which a diagnosis takes", f"{np.mean(seconds):.2f} s each"),
            Figure(
                f"{len(CORES)} workers on {len(CORES)} cores, of one",
                f"{all_ / one:.2f}",
                f"<= {1 / len(CORES) + 0.05:.2f}",
                all_ / one <= 1 / len(CORES) + 0.05,
            ),
            Figure(
                f"{SLEEPING} workers that sleep instead, of one that sleeps",
                f"{slept[SLEEPING] / slept[1]:.2f}",
                "<= 0.30",
                slept[SLEEPING] / slept[1] <= 0.3,
            ),
        ],
    )


def trial(client: Client, plant: str) -> tuple[float, dict[str, Any]]:
    """Time of a trial from when it is begun [s], and its report."""
    job = client.submit(plant, {"kind": "blindtrial", "trials": TRIALS})["id"]
    while client.job(job)["state"] == "queued":
        time.sleep(0.05)
    began = time.monotonic()
    done = client.wait(job)
    assert done["state"] == "succeeded", done
    return time.monotonic() - began, done["result"]["report"]


@contextmanager
def workers(data: Path, program: str, count: int, *arguments: str) -> Iterator[None]:
    """Workers, each on one core, which they share where there are more workers."""
    environment = {**os.environ, "TRUEUP_DATA_DIR": str(data), "TRUEUP_LOG_LEVEL": "ERROR"}
    children = [
        subprocess.Popen(
            [sys.executable, "-c", program, str(CORES[i % len(CORES)]), *arguments, "work"],
            env=environment,
            cwd=ROOT,
        )
        for i in range(count)
    ]
    time.sleep(5.0)  # until they have loaded what they need
    try:
        yield
    finally:
        for child in children:
            child.terminate()
            child.wait()


if __name__ == "__main__":
    main()
