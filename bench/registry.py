"""Version creation, promotion and resolving among many versions, beside the peer."""

from __future__ import annotations

import itertools
import json
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from bench.generator import Load, get, run, send
from bench.report import LOOP_S, Figure, loop_s, show
from bench.servers import Peer, call, ours, peer
from tests.support.made import episode_bytes, plant_document
from trueup.artifact.artifact import pack
from trueup.canonical import Json, digest_of
from trueup.episode.role import Role
from trueup.gate.decision import default_gate
from trueup.model.plant import Plant
from trueup.model.predictor import Identified
from trueup_service.actions import find
from trueup_service.actions.declare_gate import declare_gate
from trueup_service.actions.record_decision import record_decision
from trueup_service.actions.switchback import rehearse_decision
from trueup_service.actor_context import ActorContext
from trueup_service.registry.records import ArtifactRecord
from trueup_service.registry.transaction import Transaction
from trueup_service.settings import Settings
from trueup_service.wiring import build

CONNECTIONS, SECONDS, ROUNDS = 16, 3.0, 3
VERSIONS, MOVES = 12_000, 150
MANY, FEW, PAIRS = 100_000, 10, 11
CONTEXT = ActorContext("bench", "2026-01-01T00:00:00.000000Z")


def main() -> None:
    with (
        tempfile.TemporaryDirectory() as folder,
        ours(Path(folder) / "ours") as (port, _, _),
        peer(Path(folder) / "peer") as other,
    ):
        created, peer_created, loops = _create(port, other)
        promoted, aliased, more_loops = _promote(port, Path(folder) / "ours", other)
        many = _resolve(port, Path(folder) / "ours")
    for name, loads in (
        ("create", created),
        ("peer creates", peer_created),
        ("promote", promoted),
        ("peer sets alias", aliased),
    ):
        for load in loads:
            print(f"{name:>16}: {load.line()}")
    rate = _median([load.rate * s / LOOP_S for load, s in zip(created, loops, strict=True)])
    create_p99, move_p99 = (
        _median([x.quantile_ms(0.99) * LOOP_S / s for x, s in zip(loads, at, strict=True)])
        for loads, at in ((created, loops), (promoted, more_loops))
    )
    ratio, moves = (
        _median([x.rate / y.rate for x, y in zip(a, b, strict=True)])
        for a, b in ((created, peer_created), (promoted, aliased))
    )
    show(
        (
            "registry: one server process, embedded storage, 16 connections, interleaved with "
            f"the peer (one worker), median of {ROUNDS} rounds, rates and times at the speed where "
            f"a Python loop of ten million turns takes {LOOP_S} s"
        ),
        [
            Figure("the loop took, median", f"{_median(loops + more_loops):.2f} s"),
            Figure(
                "durable version creation with its audit entry",
                f"{rate:.0f} req/s",
                ">= 500 req/s",
                rate >= 500,
            ),
            Figure("… beside the peer's", f"{ratio:.1f} x", ">= 15 x", ratio >= 15),
            Figure("… p99", f"{create_p99:.1f} ms", "<= 60 ms", create_p99 <= 60),
            Figure("promotion p99", f"{move_p99:.1f} ms", "<= 60 ms", move_p99 <= 60),
            Figure("promotion beside the peer's alias", f"{moves:.1f} x", ">= 20 x", moves >= 20),
            Figure(
                f"resolve at {MANY} versions beside at {FEW}, median of {PAIRS} pairs",
                f"{many:.3f} x",
                "<= 1.1 x",
                many <= 1.1,
            ),
        ],
    )


def _create(port: int, other: Peer) -> tuple[list[Load], list[Load], list[float]]:
    plant = Plant.from_document(plant_document("creating"))
    call(port, "POST", "/v1/plants", plant_document("creating"))
    with other.awake() as where:
        call(where, "POST", "/api/2.0/mlflow/registered-models/create", {"name": "creating"})
    manifests = iter(
        [
            pack(Identified(plant, (1.0 + i / VERSIONS, 0.6, 0.8)), {}).manifest
            for i in range(VERSIONS)
        ]
    )
    body = json.dumps({"name": "creating", "source": "s3://bucket/m"}).encode()
    created, peer_created, loops = [], [], []
    for _ in range(ROUNDS):
        loops.append(loop_s())
        path = "/v1/plants/creating/artifacts"
        streams = [(send("POST", path, m) for m in manifests) for _ in range(CONNECTIONS)]
        created.append(run(port, streams, SECONDS))
        assert set(created[-1].statuses) == {201}, created[-1].statuses
        with other.awake() as where:
            create = send("POST", "/api/2.0/mlflow/model-versions/create", body)
            peer_created.append(run(where, [_again(create) for _ in range(CONNECTIONS)], SECONDS))
    return created, peer_created, loops


def _again(request: bytes) -> Iterator[bytes]:
    while True:
        yield request


def _median(values: list[float]) -> float:
    return float(np.median(values))


def _promote(port: int, data: Path, other: Peer) -> tuple[list[Load], list[Load], list[float]]:
    """Sixteen plants, each promoted again and again by decisions laid down before."""
    requests = [iter(_decisions(port, data, f"moving-{i}")) for i in range(CONNECTIONS)]
    body = json.dumps({"name": "creating", "alias": "champion", "version": "1"}).encode()
    alias = send("POST", "/api/2.0/mlflow/registered-models/alias", body)
    promoted, aliased, loops = [], [], []
    for _ in range(ROUNDS):
        loops.append(loop_s())
        streams = [itertools.islice(moves, MOVES // ROUNDS) for moves in requests]
        promoted.append(run(port, streams, 60.0))
        assert set(promoted[-1].statuses) == {200}, promoted[-1].statuses
        with other.awake() as where:
            aliased.append(run(where, [_again(alias) for _ in range(CONNECTIONS)], SECONDS))
    return promoted, aliased, loops


def _decisions(port: int, data: Path, name: str) -> list[bytes]:
    call(port, "POST", "/v1/plants", plant_document(name))
    plant = Plant.from_document(plant_document(name))
    artifacts = [pack(Identified(plant, (k, 0.6, 0.8)), {}) for k in (1.1, 1.2)]
    for artifact in artifacts:
        assert run(
            port, [iter([send("POST", f"/v1/plants/{name}/artifacts", artifact.manifest)])], 10.0
        ).statuses == {201: 1}
    held_out = send(
        "POST",
        f"/v1/plants/{name}/episodes",
        episode_bytes(9, 60, role=Role.VALIDATION),
        "application/octet-stream",
    )
    # on which the way back is rehearsed when a candidate is accepted
    assert run(port, [iter([held_out])], 60.0).statuses == {201: 1}
    episode = call(port, "GET", f"/v1/plants/{name}/episodes")["items"][0]["digest"]
    serving = call(port, "GET", f"/v1/plants/{name}/serving")["artifact"]
    parts, requests = build(Settings(data_dir=data)), []
    rehearsed: dict[tuple[str, str], dict[str, Json]] = {}
    with parts.database.write() as connection:
        tx = Transaction(connection)
        gate, _ = declare_gate(tx, name, None, CONTEXT)
        for generation in range(1, MOVES + 1):
            candidate = artifacts[generation % 2].digest
            document = {
                "gate": default_gate(2.0).digest,
                "candidate": candidate,
                "incumbent": serving,
                "generation": generation,
                "accepted": True,
                "episodes": [episode],
                "plant": plant.digest,
            }
            both = serving, candidate
            if both not in rehearsed:
                records = [find.artifact(tx, name, digest) for digest in both]
                rehearsed[both] = rehearse_decision(
                    parts.blobs,
                    parts.spool,
                    *records,
                    plant.digest,
                    document,
                    gate.document,
                    CONTEXT.now,
                )
            record_decision(tx, name, document, None, CONTEXT, rehearsed[both])
            body = json.dumps(
                {"decision": digest_of(document), "expected_generation": generation}
            ).encode()
            requests.append(send("POST", f"/v1/plants/{name}/serving/promote", body))
            serving = candidate
    parts.close()
    return requests


def _resolve(port: int, data: Path) -> float:
    """Time to resolve what serves and to get a version, at many versions beside at few: pairs, one
    after the other."""
    for name, versions in (("few", FEW), ("many", MANY)):
        call(port, "POST", "/v1/plants", plant_document(name))
        parts = build(Settings(data_dir=data))
        with parts.database.write() as connection:
            tx = Transaction(connection)
            for version in range(2, versions + 1):
                tx.artifacts.add(
                    ArtifactRecord(
                        name,
                        version,
                        digest_of([name, version]),
                        "identified",
                        "{}",
                        None,
                        None,
                        CONTEXT.now,
                        "bench",
                    )
                )
        parts.close()
    ratios = []
    for _ in range(PAIRS):
        seconds = {
            name: _time(
                port, [f"/v1/plants/{name}/serving", f"/v1/plants/{name}/versions/{versions // 2}"]
            )
            for name, versions in (("few", FEW), ("many", MANY))
        }
        ratios.append(seconds["many"] / seconds["few"])
    return float(np.median(ratios))


def _time(port: int, paths: list[str]) -> float:
    began = time.perf_counter()
    for path in paths:
        run(port, [iter([get(path)] * 300)], 30.0)
    return time.perf_counter() - began
