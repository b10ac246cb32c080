"""What serves, on PostgreSQL: two servers that read the row for each answer."""

from __future__ import annotations

import json
import tempfile
from pathlib import Path

from bench.generator import forever, get, run
from bench.report import Figure, show
from bench.servers import ROOT, call, ours
from tests.support.postgres import start_postgres

SECONDS = 3.0


def main() -> None:
    with tempfile.TemporaryDirectory() as folder, start_postgres() as postgres:
        database = {"TRUEUP_DATABASE_URL": postgres.new_database()}
        with (
            ours(Path(folder) / "a", **database) as (one, _, _),
            ours(Path(folder) / "b", **database) as (other, _, _),
        ):
            call(
                one,
                "POST",
                "/v1/plants",
                json.loads((ROOT / "examples/emps/plant.json").read_text()),
            )
            loads = {
                port: run(
                    port, [forever(get("/v1/plants/emps/serving")) for _ in range(16)], SECONDS
                )
                for port in (one, other)
            }
    rate = min(load.rate for load in loads.values())
    show(
        "scaled: GET serving from PostgreSQL, 16 connections, each of two servers in turn",
        [
            Figure("the slower server", f"{rate:.0f} req/s", ">= 1000 req/s", rate >= 1000),
            *(Figure("a server", load.line()) for load in loads.values()),
        ],
    )
