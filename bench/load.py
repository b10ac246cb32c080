"""A fleet of 1,000 robots on PostgreSQL: what serving, uploading and watching cost with one and two
servers, one and two workers.

Each robot has its own plant, token and connection. It asks every POLL_S whether its model has
changed, and every UPLOAD_S sends a batch of telemetry, at times of its own that do not wait for
answers: latencies are counted from when it meant to ask. Every tenth one wears: its monitor, which
a worker runs, should say so. Blobs are in a folder that the servers share.
"""

from __future__ import annotations

import contextlib
import io
import itertools
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from bench.generator import Asked, Load, forever, get, pace, run, send
from bench.report import Figure, show
from bench.servers import ROOT, ours, resident_mib
from tests.support.fleet import SECONDS, SIGMA, STEP_S, B, C, K, plant_document
from tests.support.made import T0_NS
from tests.support.postgres import start_postgres
from trueup.artifact.artifact import nominal_artifact, unpack
from trueup.episode.episode import Episode
from trueup.episode.role import Role
from trueup.episode.writer import write_episode
from trueup.model.plant import Plant
from trueup.monitor.monitor import Monitor, calibrate
from trueup.simulate.excitation import SHAPES, planned
from trueup.simulate.machine import Machine
from trueup.simulate.machine import run as simulated
from trueup_service.actions.add_monitor import add_monitor
from trueup_service.actions.register_plant import register_plant
from trueup_service.actions.tokens import issue_token
from trueup_service.actor_context import ActorContext
from trueup_service.authentication import new_token
from trueup_service.registry.records import Role as Of
from trueup_service.registry.records import TokenRecord
from trueup_service.registry.transaction import writing
from trueup_service.settings import Settings
from trueup_service.wiring import Parts, build

ROBOTS, WEARS = int(os.environ.get("ROBOTS", "1000")), 10
POLL_S, UPLOAD_S = 10.0, 120.0
CLOSED_S, FLEET_S, DRAIN_S = 5.0, float(os.environ.get("FLEET_S", "60")), 120.0
CONFIGURATIONS = ((1, 1), (1, 2), (2, 1), (2, 2))  # servers, workers
WORN = 0.15  # friction of a robot that wears
REFERENCE, PROMISE_H, RUNS = 40, 1.0, 24
CONTEXT = ActorContext("bench", "2026-01-01T00:00:00.000000Z")


def main() -> None:
    figures: list[Figure] = []
    with tempfile.TemporaryDirectory() as name, start_postgres() as postgres:
        folder = Path(name)
        environment = {"TRUEUP_DATABASE_URL": postgres.new_database(), "TRUEUP_LOG_LEVEL": "ERROR"}
        parts = build(Settings(data_dir=folder, database_url=environment["TRUEUP_DATABASE_URL"]))
        parts.queue.prepare()
        began = time.perf_counter()
        fleet = Fleet.commissioned(parts)
        print(f"{ROBOTS} robots commissioned in {time.perf_counter() - began:.0f} s", flush=True)
        for servers, workers in CONFIGURATIONS:
            with contextlib.ExitStack() as stack:
                running = [stack.enter_context(ours(folder, **environment)) for _ in range(servers)]
                ports, pids = (
                    [port for port, _, _ in running],
                    [child.pid for _, child, _ in running],
                )
                labour = [stack.enter_context(worker(folder, environment)) for _ in range(workers)]
                figures += _measured(fleet, parts, ports, pids, labour)
        parts.close()
    show(
        "Load: a fleet on PostgreSQL, two cores for servers, workers, database and robots", figures
    )


def _measured(
    fleet: Fleet, parts: Parts, ports: list[int], pids: list[int], labour: list[int]
) -> list[Figure]:
    name = f"{len(ports)} servers, {len(labour)} workers"
    figures = []
    for port in ports:  # a server loads the job engine when it is first asked to submit something
        assert run(port, [iter([fleet.upload(fleet.robots[1])])], 60.0).statuses == {201: 1}
    if len(labour) == 1:  # workers have nothing to do with these
        reads = [forever(get(f"/v1/plants/{fleet.robots[i].plant}/serving")) for i in range(16)]
        uploads = [
            itertools.starmap(fleet.upload, itertools.repeat((fleet.robots[-1 - i],)))
            for i in range(8)
        ]
        figures += [
            _closed(f"{name}: GET serving, 16 connections", _run_on(ports, reads)),
            _closed(
                f"{name}: uploads of {fleet.size >> 10} KiB, 8 connections", _run_on(ports, uploads)
            ),
        ]
        _drained(parts)
    alarms, watched = _counts(parts)
    peak = Peak(pids, labour)
    # made before, for whoever sends has no time to
    asks = [list(fleet.asks(robot, i)) for i, robot in enumerate(fleet.robots)]
    found = pace(
        [(ports[i % len(ports)], iter(of)) for i, of in enumerate(asks)], FLEET_S, peak.look
    )
    lag_s = _drained(parts)
    after = _counts(parts)
    wrong = {
        status: n
        for load in found.values()
        for status, n in load.statuses.items()
        if status not in (200, 201, 304)
    }
    told = [
        (
            f"{kind} {load.rate:.0f}/s, p50 {load.quantile_ms(0.5):.1f}, p99 "
            f"{load.quantile_ms(0.99):.1f} ms"
        )
        for kind, load in found.items()
    ]
    figures += [
        Figure(f"{name}: the fleet {kind.split()[0]}s", kind.split(" ", 1)[1]) for kind in told
    ]
    figures += [
        Figure(f"{name}: answers other than 200, 201, 304", str(wrong or 0), "0", not wrong),
        Figure(
            f"{name}: batches watched, then still waiting for",
            f"{after[1] - watched} by workers, {lag_s:.1f} s",
        ),
        Figure(f"{name}: alarms raised", str(after[0] - alarms)),
        Figure(
            f"{name}: memory at most, servers and workers",
            f"{peak.servers:.0f} + {peak.workers:.0f} MiB",
        ),
    ]
    return figures


def _run_on(ports: list[int], streams: list[Iterator[bytes]]) -> Load:
    return run([ports[i % len(ports)] for i in range(len(streams))], streams, CLOSED_S)


def _closed(what: str, load: Load) -> Figure:
    assert set(load.statuses) <= {200, 201}, load.statuses
    return Figure(
        what,
        (
            f"{load.rate:.0f} req/s, p50 {load.quantile_ms(0.5):.1f}, p99 "
            f"{load.quantile_ms(0.99):.1f} ms"
        ),
    )


@contextlib.contextmanager
def worker(data: Path, environment: dict[str, str]) -> Iterator[int]:
    """A worker; its process."""
    child = subprocess.Popen(
        [sys.executable, "-m", "trueup_cli.main", "work"],
        env={**os.environ, "TRUEUP_DATA_DIR": str(data), **environment},
        cwd=ROOT,
    )
    try:
        time.sleep(5.0)
        yield child.pid
    finally:
        child.terminate()
        child.wait()


class Peak:
    """The most memory that was seen [MiB]."""

    def __init__(self, servers: list[int], workers: list[int]) -> None:
        self._servers, self._workers = servers, workers
        self.servers = self.workers = 0.0

    def look(self) -> None:
        self.servers = max(self.servers, *(resident_mib(pid) for pid in self._servers))
        self.workers = max(self.workers, *(resident_mib(pid) for pid in self._workers))


@dataclass(frozen=True)
class Robot:
    """A plant, the token of its robot, and whether it wears."""

    plant: str
    token: str
    wears: bool


@dataclass
class Fleet:
    """Robots of one make, and what they record: each batch has a start of its own, so that no two
    are the same bytes."""

    robots: list[Robot]
    plant: Plant
    healthy: list[Recorded]
    worn: list[Recorded]
    batches: Iterator[int]

    @staticmethod
    def commissioned(parts: Parts) -> Fleet:
        """Plants, tokens and monitors, the latter calibrated once, for all of them are alike."""
        plant, rng = Plant.from_document(plant_document("robot-0000")), np.random.default_rng(5)
        healthy, worn = (
            [recorded(friction, i, rng) for i in range(RUNS)] for friction in (0.0, WORN)
        )
        fleet = Fleet([], plant, healthy, worn, itertools.count(1))
        reference = [fleet.episode(recorded(0.0, i, rng), Role.REFERENCE) for i in range(REFERENCE)]
        artifact = nominal_artifact(plant)
        monitor = calibrate(
            unpack(artifact, artifact.digest), artifact.digest, reference, PROMISE_H
        )
        for i in range(ROBOTS):
            fleet.robots.append(
                _commissioned(parts, monitor, f"robot-{i:04d}", wears=i % WEARS == 0)
            )
        return fleet

    def episode(self, run: Recorded, role: Role) -> Episode:
        columns = run.observed.copy(), self.plant.layout
        return Episode(
            run.t_s.copy(), run.issued.copy(), *columns, role, {"stage": "SIL"}, 0, f"run-{id(run)}"
        )

    @property
    def size(self) -> int:
        return len(self.batch(self.healthy[0]))

    def batch(self, run: Recorded) -> bytes:
        """Telemetry as MCAP."""
        stamps = T0_NS + next(self.batches) * 10**11 + np.rint(run.t_s * 1e9).astype(np.int64)
        file = io.BytesIO()
        columns = {
            "observations": run.observed,
            "commands": run.issued,
            "layout": self.plant.layout,
        }
        write_episode(
            file, stamps_ns=stamps, role=Role.TELEMETRY, conditions={"stage": "SIL"}, **columns
        )
        return file.getvalue()

    def upload(self, robot: Robot) -> bytes:
        """The next batch of a robot, as a request."""
        runs = self.worn if robot.wears else self.healthy
        number = next(self.batches)
        return send(
            "POST",
            f"/v1/plants/{robot.plant}/episodes",
            self.batch(runs[number % RUNS]),
            "application/octet-stream",
            robot.token,
        )

    def asks(self, robot: Robot, number: int) -> Iterator[Asked]:
        """When a robot asks what, from now on."""
        poll = get(
            f"/v1/plants/{robot.plant}/serving",
            Authorization=f"Bearer {robot.token}",
            If_None_Match='"1"',
        )
        phase = (number * 0.6180339887) % 1.0
        times = [(phase * POLL_S + i * POLL_S, "poll") for i in range(int(FLEET_S / POLL_S))]
        times += [
            (((number * 0.7548776662) % 1.0) * UPLOAD_S + i * UPLOAD_S, "upload")
            for i in range(1 + int(FLEET_S / UPLOAD_S))
        ]
        for due_s, kind in sorted(times):
            yield Asked(due_s, kind, poll if kind == "poll" else self.upload(robot))


@dataclass(frozen=True, eq=False)
class Recorded:
    """What a machine did in one batch: times [s], states and commands as they were seen."""

    t_s: np.ndarray
    observed: np.ndarray
    issued: np.ndarray


def recorded(friction: float, number: int, rng: np.random.Generator) -> Recorded:
    """A batch of a machine that is as its model says but for friction."""
    machine = Machine("oscillator", K, C, B, 1.0)
    machine = machine.having("coulomb_friction", {"level": friction}) if friction else machine
    series = 0.8 * planned(SHAPES[number % len(SHAPES)], round(SECONDS / STEP_S) + 51, STEP_S, rng)
    found = simulated(machine, series, STEP_S, 20, SIGMA, rng, warm_up=50)
    return Recorded(found.t_s, found.observed, found.issued[:, None])


def _commissioned(parts: Parts, monitor: Monitor, name: str, *, wears: bool) -> Robot:
    token, prefix, secret = new_token()
    with writing(parts.database) as tx:
        record, _ = register_plant(tx, plant_document(name), CONTEXT)
        artifact = nominal_artifact(Plant.from_document(plant_document(name))).digest
        mine = replace(monitor, plant=record.digest, artifact=artifact)
        kept = {detector: list(state) for detector, state in mine.begin().items()}
        add_monitor(
            tx, name, json.loads(json.dumps(mine.document())), kept, None, CONTEXT.now, CONTEXT
        )
        issue_token(
            tx,
            TokenRecord(
                prefix, secret, name, [Of.ROBOT], None, name, CONTEXT.now, CONTEXT.actor, None
            ),
            CONTEXT,
        )
    return Robot(name, token, wears)


def _counts(parts: Parts) -> tuple[int, int]:
    """Alarms raised and batches watched so far."""
    with parts.database.read() as connection:
        alarms, watched = (
            connection.exec_driver_sql(f"SELECT count(*) FROM {table}").scalar_one()
            for table in ("alarms", "watches")
        )
    return alarms, watched


def _drained(parts: Parts) -> float:
    """Wait until the workers have nothing left to do; how long that took [s]."""
    began = time.monotonic()
    while time.monotonic() - began < DRAIN_S:
        with parts.database.read() as connection:
            if not connection.exec_driver_sql(
                "SELECT count(*) FROM jobs WHERE result IS NULL"
            ).scalar_one():
                break
        time.sleep(0.1)
    return time.monotonic() - began
