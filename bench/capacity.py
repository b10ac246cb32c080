"""What each thing that a fleet does costs, in seconds of one core, bytes and rows: the numbers that
docs/capacity.md computes with.

On PostgreSQL, with one server, one worker and the blobs in a folder, one thing after the other.
"""

from __future__ import annotations

import io
import itertools
import json
import os
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from bench import load
from bench.generator import Load, forever, get, run, send
from bench.load import Fleet, worker
from bench.report import MEASURED, Figure, loop_s, show
from bench.servers import ROOT, TOKEN, cpu_s, descendants, ours, resident_mib
from tests.support.made import T0_NS, identified
from tests.support.postgres import start_postgres
from trueup.artifact.artifact import pack
from trueup.episode.role import Role
from trueup.episode.writer import write_episode
from trueup.model.plant import Plant
from trueup.model.predictor import Identified
from trueup_client import Client
from trueup_service.registry.transaction import writing
from trueup_service.settings import Settings
from trueup_service.wiring import Parts, build

ROBOTS, CONNECTIONS, SECONDS = 40, 8, 6.0
LONG = 120  # times the samples of a short recording, in a long one
LONG_UPLOADS = 24
HELD = 400  # connections that wait for a change
MIB = 1 << 20
EMPS = ROOT / "examples" / "emps"


def main() -> None:
    load.ROBOTS = ROBOTS
    with tempfile.TemporaryDirectory() as name, start_postgres() as postgres:
        folder, url = Path(name), postgres.new_database()
        environment = {"TRUEUP_DATABASE_URL": url, "TRUEUP_LOG_LEVEL": "ERROR"}
        parts = build(Settings(data_dir=folder, database_url=url))
        parts.queue.prepare()
        fleet = Fleet.commissioned(parts)
        with ours(folder, **environment) as (port, server, _):
            meter = Meter(server.pid)
            warm = [iter([fleet.upload(robot)]) for robot in fleet.robots]
            assert set(run(port, warm, 60.0).statuses) == {201}
            costs: dict[str, Any] = {"loop_s": loop_s()}
            costs |= _polls(meter, port, fleet)
            costs |= _uploads(meter, port, fleet, parts)
            costs |= _versions(meter, port, parts)
            costs |= _held(port, server.pid, fleet)
            with worker(folder, environment) as pid:
                costs |= _watches(meter, pid, parts)
                costs |= _diagnosis(pid, port)
        costs["entries_per_s"] = _entries_per_s(parts)
        parts.close()
    if os.environ.get("PUBLISH"):
        (MEASURED / "capacity.json").write_text(json.dumps(costs, indent=1) + "\n")
    show(
        "Capacity: what each thing costs, on PostgreSQL, in milliseconds of a core",
        [Figure(name, f"{value:.4g}") for name, value in costs.items()],
    )


class Meter:
    """What the server with its inspector, and the database, have taken of the cores [s]."""

    def __init__(self, server: int) -> None:
        self._server = server

    def server(self) -> float:
        return _tree_s(self._server)

    def database(self) -> float:
        pids = []
        for comm in Path("/proc").glob("[0-9]*/comm"):
            try:
                if comm.read_text().strip() == "postgres":
                    pids.append(int(comm.parent.name))
            except OSError:
                continue
        return cpu_s(pids)

    def of(self, name: str, count: int, before: tuple[float, float]) -> dict[str, float]:
        """The costs of one of `count` things since `before` [ms]."""
        server, database = self.server() - before[0], self.database() - before[1]
        return {
            f"{name}_server_ms": 1e3 * server / count,
            f"{name}_database_ms": 1e3 * database / count,
        }

    def now(self) -> tuple[float, float]:
        return self.server(), self.database()


def _polls(meter: Meter, port: int, fleet: Fleet) -> dict[str, float]:
    before, robots = meter.now(), fleet.robots
    asks = [
        forever(
            get(
                f"/v1/plants/{robot.plant}/serving",
                Authorization=f"Bearer {robot.token}",
                If_None_Match='"1"',
            )
        )
        for robot in robots[:CONNECTIONS]
    ]
    polled = run(port, asks, SECONDS)
    assert set(polled.statuses) == {304}
    return {"polls_per_s": polled.rate, **meter.of("poll", len(polled.latencies), before)}


def _uploads(meter: Meter, port: int, fleet: Fleet, parts: Parts) -> dict[str, float]:
    rows_before, before = _database_bytes(parts), meter.now()
    short = _closed_uploads([port], fleet)
    costs = meter.of("short_upload", len(short.latencies), before)
    costs["short_upload_bytes"] = fleet.size
    costs["uploads_per_s"] = short.rate
    costs["rows_bytes"] = (_database_bytes(parts) - rows_before) / len(short.latencies)
    before, bodies = meter.now(), [_long(fleet, i) for i in range(LONG_UPLOADS)]
    size = len(bodies[0])
    per = LONG_UPLOADS // 4
    streams = [iter(bodies[i * per : (i + 1) * per]) for i in range(4)]
    long = run(port, streams, 120.0)
    assert set(long.statuses) == {201}
    costs |= meter.of("long_upload", len(long.latencies), before)
    return {**costs, "long_upload_bytes": size}


def _closed_uploads(ports: list[int], fleet: Fleet) -> Load:
    streams = [
        itertools.starmap(fleet.upload, itertools.repeat((fleet.robots[i],)))
        for i in range(2 * CONNECTIONS)
    ]
    done = run([ports[i % len(ports)] for i in range(len(streams))], streams, SECONDS)
    assert set(done.statuses) == {201}, done.statuses
    return done


def _long(fleet: Fleet, number: int) -> bytes:
    """The upload of a recording that is LONG times as long as a batch."""
    runs = [fleet.healthy[(number + i) % len(fleet.healthy)] for i in range(LONG)]
    step_s = runs[0].t_s[1] - runs[0].t_s[0]
    observed = np.concatenate([r.observed for r in runs])
    stamps = (
        T0_NS
        + (10**4 + number) * 10**13
        + np.rint(np.arange(len(observed)) * step_s * 1e9).astype(np.int64)
    )
    file = io.BytesIO()
    write_episode(
        file,
        stamps_ns=stamps,
        observations=observed,
        commands=np.concatenate([r.issued for r in runs]),
        layout=fleet.plant.layout,
        role=Role.ADAPTATION,
        conditions={"stage": "SIL"},
    )
    robot = fleet.robots[number % len(fleet.robots)]
    path = f"/v1/plants/{robot.plant}/episodes"
    return send("POST", path, file.getvalue(), "application/octet-stream", robot.token)


def _database_bytes(parts: Parts) -> int:
    with parts.database.read() as connection:
        query = "SELECT pg_database_size(current_database())"
        return int(connection.exec_driver_sql(query).scalar_one())


def _versions(meter: Meter, port: int, parts: Parts) -> dict[str, float]:
    from tests.support.made import plant_document

    with Client(f"http://127.0.0.1:{port}", token=TOKEN) as client:
        client.register_plant(plant_document("versions"))
    plant = Plant.from_document(plant_document("versions"))

    def versions(begin: int) -> Iterator[bytes]:
        for number in itertools.count(begin):
            made = pack(Identified(plant, (1.0 + 1e-6 * number, 0.6, 0.8)), {"origin": "bench"})
            yield send("POST", "/v1/plants/versions/artifacts", made.manifest)

    assert identified("versions").manifest
    before = meter.now()
    made = run(port, [versions(10**6 * i) for i in range(1, 1 + CONNECTIONS)], SECONDS)
    assert set(made.statuses) == {201}
    return {"versions_per_s": made.rate, **meter.of("version", len(made.latencies), before)}


def _held(port: int, pid: int, fleet: Fleet) -> dict[str, float]:
    """Memory of the server for each connection that waits for a change [KiB]."""
    import socket

    before, held = resident_mib(pid), []
    for i in range(HELD):
        robot = fleet.robots[i % len(fleet.robots)]
        ask = get(
            f"/v1/plants/{robot.plant}/serving?wait_s=50",
            Authorization=f"Bearer {robot.token}",
            If_None_Match='"1"',
        )
        held.append(socket.create_connection(("127.0.0.1", port)))
        held[-1].sendall(ask)
    time.sleep(3.0)
    after = resident_mib(pid)
    for connection in held:
        connection.close()
    return {"held_kib": 1024 * (after - before) / HELD, "server_mib": before}


def _watches(meter: Meter, pid: int, parts: Parts) -> dict[str, float]:
    began, before, database = time.monotonic(), _tree_s(pid), meter.database()
    watched = load._counts(parts)[1]
    load._drained(parts)
    count = load._counts(parts)[1] - watched
    took_s = time.monotonic() - began
    return {
        "watches_per_s": count / took_s,
        "watch_worker_ms": 1e3 * (_tree_s(pid) - before) / count,
        "watch_database_ms": 1e3 * (meter.database() - database) / count,
        "worker_mib": sum(resident_mib(p) for p in [pid, *descendants(pid)]),
    }


def _entries_per_s(parts: Parts) -> float:
    """How many changes one log takes, if they do nothing else: each is a transaction that waits for
    the head, adds an entry and commits."""
    until, counts = time.monotonic() + SECONDS, []

    def write() -> None:
        count = 0
        while time.monotonic() < until:
            with writing(parts.database) as tx:
                tx.log.append(load.CONTEXT, "bench:entry", plant=None, subject="", facts={})
            count += 1
        counts.append(count)

    threads = [threading.Thread(target=write) for _ in range(CONNECTIONS)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return sum(counts) / SECONDS


def _diagnosis(pid: int, port: int) -> dict[str, float]:
    """A diagnosis of the EMPS, a real axis of which positions are logged."""
    with Client(f"http://127.0.0.1:{port}", token=TOKEN) as client:
        client.register_plant(json.loads((EMPS / "plant.json").read_text()))
        for file in sorted(EMPS.glob("*.mcap")):
            client.upload_episode("emps", file)
        before, began = _tree_s(pid), time.monotonic()
        job = client.wait(client.submit("emps", {"kind": "diagnose"})["id"])
        assert job["state"] == "succeeded"
    return {
        "diagnosis_worker_s": _tree_s(pid) - before,
        "diagnosis_wall_s": time.monotonic() - began,
    }


def _tree_s(pid: int) -> float:
    return cpu_s([pid, *descendants(pid)])
