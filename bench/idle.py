"""What an idle server and its idle worker take of a core, on both storages, and how long a sleeping
worker needs to begin a job."""

from __future__ import annotations

import json
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from bench.report import Figure, show
from bench.servers import ROOT, TOKEN, cpu_s, descendants, ours
from tests.support.postgres import start_postgres
from trueup_client import Client

ASLEEP_S, MEASURED_S = 25.0, 40.0  # after the last job; over which the share is taken


def main() -> None:
    with tempfile.TemporaryDirectory() as folder, start_postgres() as postgres:
        figures = [
            *_of("SQLite", Path(folder) / "sqlite", {}),
            *_of(
                "PostgreSQL",
                Path(folder) / "postgres",
                {"TRUEUP_DATABASE_URL": postgres.new_database()},
            ),
        ]
    show("idle: shares of a core without any request or job", figures)


def _of(name: str, data: Path, environment: dict[str, str]) -> Iterator[Figure]:
    with ours(data, worker=True, **environment) as (port, child, _):
        with Client(f"http://127.0.0.1:{port}", token=TOKEN) as client:
            client.register_plant(json.loads((ROOT / "examples/emps/plant.json").read_text()))
            for file in sorted((ROOT / "examples/emps").glob("*.mcap")):
                client.upload_episode("emps", file)
            waits = []
            for sleep_s in (0.0, ASLEEP_S, ASLEEP_S):
                time.sleep(sleep_s)
                began = time.monotonic()
                job = client.submit("emps", {"kind": "fit", "method": "identify"})["id"]
                while client.job(job)["state"] == "queued":
                    time.sleep(0.005)
                waits.append(time.monotonic() - began)
                client.wait(job)
        time.sleep(ASLEEP_S)
        worker = descendants(child.pid)
        before = [cpu_s(pids) for pids in ([child.pid], worker)]
        time.sleep(MEASURED_S)
        server, its_worker = (
            (cpu_s(pids) - was) / MEASURED_S
            for pids, was in zip(([child.pid], worker), before, strict=True)
        )
    yield Figure(f"{name}: the server", f"{server:.2%}", "<= 0.2 %", server <= 0.002)
    yield Figure(f"{name}: its worker", f"{its_worker:.2%}")
    both = server + its_worker
    yield Figure(f"{name}: both", f"{both:.2%}", "<= 0.5 %", both <= 0.005)
    yield Figure(
        f"{name}: until a job is begun: the first, and two of a sleeping worker",
        ", ".join(f"{wait:.2f} s" for wait in waits),
    )
