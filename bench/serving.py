"""What serves: rates and latencies beside the peer's alias, freshness is held by the tests."""

from __future__ import annotations

import json
import tempfile
from pathlib import Path

from bench.generator import Load, forever, get, run
from bench.report import Figure, show
from bench.servers import ROOT, call, ours, peer

ASK = get("/v1/plants/emps/serving")
SAME = get("/v1/plants/emps/serving", If_None_Match='"1"')
ALIAS = get("/api/2.0/mlflow/registered-models/alias?name=m&alias=champion")
SECONDS = 3.0
ROUNDS = 3


def main() -> None:
    plant = json.loads((ROOT / "examples/emps/plant.json").read_text())
    with (
        tempfile.TemporaryDirectory() as folder,
        ours(Path(folder) / "ours") as (port, _, _),
        peer(Path(folder) / "peer") as other,
    ):
        call(port, "POST", "/v1/plants", plant)
        with other.awake() as where:
            _fill_peer(where)
        loads: dict[str, list[Load]] = {}
        for _ in range(ROUNDS):
            for name, request, connections in (
                ("16", ASK, 16),
                ("1", ASK, 1),
                ("304", SAME, 16),
                ("304 at 1", SAME, 1),
            ):
                loads.setdefault(name, []).append(
                    run(port, [forever(request) for _ in range(connections)], SECONDS)
                )
            with other.awake() as where:
                for name, connections in (("peer 16", 16), ("peer 1", 1)):
                    loads.setdefault(name, []).append(
                        run(where, [forever(ALIAS) for _ in range(connections)], SECONDS)
                    )
    assert all(set(load.statuses) <= {200, 304} for found in loads.values() for load in found)
    best = {
        name: sorted(found, key=lambda load: load.rate)[ROUNDS // 2]
        for name, found in loads.items()
    }
    for name, load in best.items():
        print(f"{name:>9}: {load.line()}")
    ratio, single = best["16"].rate / best["peer 16"].rate, best["1"].rate / best["peer 1"].rate
    show(
        (
            "serving: one server process, embedded storage, median of three runs of 3 s each, "
            "interleaved with the peer (one worker)"
        ),
        [
            Figure(
                "GET serving, 16 connections",
                f"{best['16'].rate:.0f} req/s",
                ">= 4000 req/s",
                best["16"].rate >= 4000,
            ),
            Figure(
                "… beside the peer's alias, 16 connections",
                f"{ratio:.1f} x",
                ">= 20 x",
                ratio >= 20,
            ),
            Figure(
                "GET serving, 1 connection, p50",
                f"{best['1'].quantile_ms(0.5):.3f} ms",
                "<= 0.5 ms",
                best["1"].quantile_ms(0.5) <= 0.5,
            ),
            Figure("… beside the peer's alias, 1 connection", f"{single:.1f} x"),
            Figure(
                "304, 16 connections",
                f"{best['304'].rate:.0f} req/s",
                "faster than 200",
                best["304"].rate > best["16"].rate,
            ),
            Figure("304, 1 connection, p50", f"{best['304 at 1'].quantile_ms(0.5):.3f} ms"),
        ],
    )


def _fill_peer(port: int) -> None:
    call(port, "POST", "/api/2.0/mlflow/registered-models/create", {"name": "m"})
    call(
        port,
        "POST",
        "/api/2.0/mlflow/model-versions/create",
        {"name": "m", "source": "s3://bucket/m"},
    )
    call(
        port,
        "POST",
        "/api/2.0/mlflow/registered-models/alias",
        {"name": "m", "alias": "champion", "version": "1"},
    )
