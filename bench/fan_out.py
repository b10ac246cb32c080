"""One diagnosis by one worker and by several, each with a core of its own, in turn on one service;
the reports are compared.

The server, its database and whoever waits share those cores.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from bench.report import Figure, show
from bench.servers import ROOT, TOKEN, call, ours

CASES = os.environ.get("CASES", "examples/emps").split()
ROUNDS = int(os.environ.get("ROUNDS", "3"))
MANY = len(os.sched_getaffinity(0))


@contextmanager
def workers(data: Path, many: int) -> Iterator[None]:
    """So many, each on a core of its own."""
    environment = {
        **os.environ,
        "TRUEUP_DATA_DIR": str(data),
        "TRUEUP_LOG_LEVEL": os.environ.get("LEVEL", "ERROR"),
    }
    command = (
        "import os, runpy, sys; os.sched_setaffinity(0, {int(sys.argv.pop(1))}); "
        "runpy.run_module('trueup_cli.main', run_name='__main__')"
    )
    children = [
        subprocess.Popen(
            [sys.executable, "-c", command, str(core), "work"], env=environment, cwd=ROOT
        )
        for core in sorted(os.sched_getaffinity(0))[:many]
    ]
    try:
        yield
    finally:
        for child in children:
            child.terminate()
            child.wait()


def diagnosed(port: int, plant: str) -> tuple[float, str]:
    """Time that a diagnosis took from its first stage to its end [s], and its report."""
    job = call(port, "POST", f"/v1/plants/{plant}/jobs", {"kind": "diagnose"})["id"]
    began = None
    while True:
        found = call(port, "GET", f"/v1/jobs/{job}")
        if began is None and found["state"] != "queued":
            began = time.perf_counter()
        if found["result"] is not None:
            assert began is not None
            assert found["state"] == "succeeded", found
            return time.perf_counter() - began, json.dumps(
                found["result"]["report"], sort_keys=True
            )
        time.sleep(0.1)


def uploaded(port: int, folder: Path) -> str:
    """The plant of a case with its episodes."""
    environment = {**os.environ, "TRUEUP_URL": f"http://127.0.0.1:{port}", "TRUEUP_TOKEN": TOKEN}
    for command in (
        ["plant", "register", str(folder)],
        ["upload", json.loads((folder / "plant.json").read_text())["name"], str(folder)],
    ):
        subprocess.run(
            [sys.executable, "-m", "trueup_cli.main", *command],
            env=environment,
            cwd=ROOT,
            check=True,
            capture_output=True,
        )
    return json.loads((folder / "plant.json").read_text())["name"]


def main() -> None:
    figures = []
    with (
        tempfile.TemporaryDirectory() as folder,
        ours(Path(folder), TRUEUP_LOG_LEVEL="ERROR") as (port, _, _),
    ):
        for case in CASES:
            plant = uploaded(port, ROOT / case)
            took: dict[int, list[float]] = {1: [], MANY: []}
            reports = set()
            for many, seconds in [*took.items()] * ROUNDS:
                with workers(Path(folder), many):
                    time.sleep(5.0)  # until all of them look at the queue
                    # workers run for days: what they load on first use is
                    # loaded
                    diagnosed(port, plant)
                    elapsed, report = diagnosed(port, plant)
                seconds.append(elapsed)
                reports.add(report)
            one, several = (float(np.median(took[many])) for many in (1, MANY))
            ratios = sorted(a / b for a, b in zip(took[1], took[MANY], strict=True))
            text = f"{one / several:.2f} x ({ratios[0]:.2f} to {ratios[-1]:.2f})"
            figures += [
                Figure(
                    f"{case}: one worker on one core, {MANY} on {MANY}",
                    f"{one:.1f} s, {several:.1f} s",
                ),
                Figure(
                    f"{case}: as fast with {MANY} workers as with one",
                    text,
                    f"> 1.3 x, of {MANY}",
                    one / several > 1.3,
                ),
                Figure(f"{case}: different reports", str(len(reports) - 1), "0", len(reports) == 1),
            ]
    show("fan_out: one diagnosis by several workers", figures)
