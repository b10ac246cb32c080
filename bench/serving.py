"""What serves: rates and latencies beside the peer's alias, freshness is held by the tests."""

from __future__ import annotations

import json
import tempfile
from pathlib import Path

import numpy as np

from bench.generator import Load, forever, get, run
from bench.report import Figure, loop_s, show
from bench.servers import ROOT, call, ours, peer

ASK = get("/v1/plants/emps/serving")
SAME = get("/v1/plants/emps/serving", If_None_Match='"1"')
ALIAS = get("/api/2.0/mlflow/registered-models/alias?name=m&alias=champion")
SECONDS, PEER_S = 1.5, 3.0
ROUNDS = 6


def main() -> None:
    plant = json.loads((ROOT / "examples/emps/plant.json").read_text())
    with (
        tempfile.TemporaryDirectory() as folder,
        ours(Path(folder) / "ours") as (port, _, _),
        ours(Path(folder) / "open", module="bench.open_server") as (unguarded, _, _),
        ours(Path(folder) / "two", arguments=("--processes", "2")) as (two, _, _),
        peer(Path(folder) / "peer") as other,
    ):
        for each in (port, unguarded, two):
            call(each, "POST", "/v1/plants", plant)
        with other.awake() as where:
            _fill_peer(where)
        loads: dict[str, list[Load]] = {}
        loops = []
        for turn in range(ROUNDS):
            loops.append(loop_s())
            measured = (
                ("16", port, ASK, 16),
                ("304", port, SAME, 16),
                ("no token", unguarded, ASK, 16),
                ("two", two, ASK, 16),
                ("1", port, ASK, 1),
                ("304 at 1", port, SAME, 1),
            )
            for name, at, request, connections in measured[turn:] + measured[:turn]:
                loads.setdefault(name, []).append(
                    run(at, [forever(request) for _ in range(connections)], SECONDS)
                )
            with other.awake() as where:
                for name, connections in (("peer 16", 16), ("peer 1", 1)):
                    loads.setdefault(name, []).append(
                        run(where, [forever(ALIAS) for _ in range(connections)], PEER_S)
                    )
    assert all(set(load.statuses) <= {200, 304} for runs in loads.values() for load in runs)
    middle = {
        name: sorted(runs, key=lambda load: load.rate)[ROUNDS // 2] for name, runs in loads.items()
    }
    for name, load in middle.items():
        print(f"{name:>9}: {load.line()}")

    def beside(name: str, reference: str) -> float:
        """The median over the rounds of a rate beside another one of the same round."""
        pairs = zip(loads[name], loads[reference], strict=True)
        return float(np.median([a.rate / b.rate for a, b in pairs]))

    ratio, guarded = beside("16", "peer 16"), beside("16", "no token")
    unchanged, p50 = beside("304", "16"), middle["1"].quantile_ms(0.5)
    show(
        (
            f"serving: one server process, embedded storage, median of {ROUNDS} runs of "
            f"{SECONDS:g} s each, interleaved with the peer (one worker)"
        ),
        [
            Figure("a Python loop of ten million turns, median", f"{np.median(loops):.2f} s"),
            Figure("GET serving, 16 connections", f"{middle['16'].rate:.0f} req/s"),
            Figure(
                "… beside the peer's alias, 16 connections",
                f"{ratio:.1f} x",
                ">= 100 x",
                ratio >= 100,
            ),
            Figure("GET serving, 1 connection, p50", f"{p50:.3f} ms", "<= 0.5 ms", p50 <= 0.5),
            Figure("… beside the peer's alias, 1 connection", f"{beside('1', 'peer 1'):.1f} x"),
            Figure("304 beside 200, 16 connections", f"{unchanged:.2f} x", "> 1 x", unchanged > 1),
            Figure("304 beside 200, 1 connection", f"{beside('304 at 1', '1'):.2f} x"),
            Figure(
                "GET serving beside a server that asks for no token",
                f"{guarded:.2f} x",
                ">= 0.9 x",
                guarded >= 0.9,
            ),
            Figure("two server processes beside one", f"{beside('two', '16'):.2f} x"),
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
