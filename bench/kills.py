"""500 kills of server and worker, random in time and at every step towards disk and database, on
both storages: is anything lost?

The checker is first shown a planted loss of each kind.
"""

from __future__ import annotations

import contextlib
import itertools
import os
import random
import subprocess
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import obstore
from sqlalchemy import text

from bench.report import Figure, show
from bench.servers import TOKEN
from tests.support.faults import arm
from tests.support.gates import LENIENT
from tests.support.history import History, problems
from tests.support.made import episode_bytes, plant_document
from tests.support.postgres import start_postgres
from tests.support.s3 import start_s3
from tests.support.service import Service, kill
from tests.support.storage import Storage, embedded, scaled
from trueup.episode.role import Role
from trueup_client import Client
from trueup_client.problem import ClientError
from trueup_service.actor_context import ActorContext
from trueup_service.registry.folder_blobs import FolderBlobs
from trueup_service.registry.transaction import writing
from trueup_service.wiring import Parts

KILLS, USERS, SEED = int(os.environ.get("KILLS", "500")), 3, 99
STORAGES = os.environ.get("STORAGES", "embedded scaled").split()
STEPS = 14  # an upload has about as many
FAULTY = "tests.support.faults"
END_S = 180.0
_seeds = itertools.count(1)


def main() -> None:
    with tempfile.TemporaryDirectory() as folder, start_postgres() as postgres, start_s3() as s3:
        data = Path(folder)
        figures = [
            _run(storage, data / storage.name)
            for storage in (embedded(data / "a"), scaled(data / "b", postgres, s3))
            if storage.name in STORAGES
        ]
    show("Kills", figures)


class Killed:
    """Server and worker, each with a file from which its death comes."""

    def __init__(self, storage: Storage, folder: Path) -> None:
        folder.mkdir()
        self.service = Service(storage, checkpoint_interval_s=2)
        self.faults = {name: folder / name for name in ("server", "worker")}
        self.children: dict[str, subprocess.Popen] = {}
        for name in self.faults:
            self.start(name)

    def start(self, name: str) -> None:
        self.faults[name].unlink(missing_ok=True)
        os.environ["FAULT_FILE"] = str(self.faults[name])
        self.children[name] = (
            self.service.start_server(module=FAULTY)
            if name == "server"
            else self.service.start_worker(FAULTY)
        )

    def die(self, rng: random.Random) -> str:
        """Kill one of them, at a random time or at a random step; which way."""
        name = rng.choice(("server", "server", "worker"))
        child = self.children[name]
        way = "in time"
        if rng.random() < 0.5:
            way = "at a step"
            arm(self.faults[name], "kill", rng.randint(1, STEPS))
            with contextlib.suppress(subprocess.TimeoutExpired):
                child.wait(timeout=5)
        else:
            time.sleep(rng.uniform(0.0, 0.5))
        if child.poll() is None:
            kill(child)
        self.service._children.remove(child)
        self.start(name)
        return way


def _run(storage: Storage, folder: Path) -> Figure:
    rng, history, stop = random.Random(SEED), History(), threading.Event()
    killed = Killed(storage, folder)
    users = [
        threading.Thread(target=_use, args=(killed.service.url, f"p{n}", history, stop))
        for n in range(USERS)
    ]
    for user in users:
        user.start()
    began, ways = time.monotonic(), {"in time": 0, "at a step": 0}
    for count in range(1, KILLS + 1):
        ways[killed.die(rng)] += 1
        time.sleep(rng.uniform(0.1, 0.5))
        if count % 50 == 0:
            print(
                (
                    f"{storage.name}: {count} kills, {len(history)} acknowledged, "
                    f"{time.monotonic() - began:.0f} s"
                ),
                flush=True,
            )
    stop.set()
    for user in users:
        user.join()
    parts = storage.build()
    deadline = time.monotonic() + END_S
    while (found := problems(history, parts)) and time.monotonic() < deadline:
        time.sleep(2.0)  # jobs that were accepted last
    killed.service.stop()
    print(*found, sep="\n")
    planted = _planted(history, parts)
    parts.close()
    what = (
        f"{storage.name}: lost, torn, doubled of {len(history)} acknowledged, "
        f"{ways['at a step']} kills at a step"
    )
    return Figure(
        what,
        f"{len(found)} after {KILLS} kills",
        f"0; planted: {planted}",
        not found and planted == "3 of 3 found",
    )


def _use(url: str, plant: str, history: History, stop: threading.Event) -> None:
    """An engineer who goes on whatever happens; only what was acknowledged counts."""
    steps = _steps(plant, history)
    client = Client(url, token=TOKEN, timeout_s=20)
    act = next(steps)
    while not stop.is_set():
        try:
            act(client)
        except ClientError:
            client.close()
            time.sleep(0.1)
        except (TimeoutError, KeyError, StopIteration):
            pass
        act = next(steps)
    client.close()


def _steps(plant: str, history: History) -> Iterator:
    candidate: list[str] = []
    decided: list[str] = []

    def register(client: Client) -> None:
        client.register_plant(plant_document(plant))

    def upload(client: Client, role: Role = Role.ADAPTATION) -> None:
        with tempfile.NamedTemporaryFile() as file:
            file.write(episode_bytes(next(_seeds), 60, role=role))
            file.flush()
            history.note("episodes", (plant, client.upload_episode(plant, file.name)["digest"]))

    def gate(client: Client) -> str:
        scoring = {"horizon_s": 1.0 + next(_seeds) / 1e4, "windows": "first"}
        digest = client.declare_gate(plant, LENIENT | {"scoring": scoring})["digest"]
        history.note("gates", (plant, digest))
        return digest

    def fit(client: Client) -> None:
        job = client.submit(plant, {"kind": "fit", "method": "identify"})["id"]
        history.note("jobs", job)
        candidate.append(client.wait(job)["result"]["artifact"])

    def judge(client: Client) -> None:
        if candidate:
            job = client.submit(
                plant, {"kind": "gate", "candidate": candidate[-1], "gate": gate(client)}
            )["id"]
            history.note("jobs", job)
            decided.append(client.wait(job)["result"]["decision"])

    def promote(client: Client) -> None:
        if decided:
            moved = client.promote(plant, decided.pop(), client.serving(plant).generation)
            history.note("moves", (plant, moved.generation, moved.artifact))

    def back(client: Client) -> None:
        moved = client.roll_back(plant, client.serving(plant).generation)
        history.note("moves", (plant, moved.generation, moved.artifact))

    while True:
        yield from (
            register,
            upload,
            lambda c: upload(c, Role.VALIDATION),
            gate,
            fit,
            judge,
            promote,
            upload,
            back,
            gate,
        )


def _planted(history: History, parts: Parts) -> str:
    """A blob, a row and an entry done twice: does the checker see each?"""
    plant, digest = next(iter(sorted(history.episodes)))
    seen = 0
    if isinstance(parts.blobs, FolderBlobs):
        path = parts.settings.data_dir / "blobs" / digest[:2] / digest[2:]
        kept = path.read_bytes()
        path.unlink()
        seen += any(p.startswith("torn") for p in problems(history, parts))
        path.write_bytes(kept)
    else:
        kept = parts.blobs.get(digest)
        obstore.delete(parts.blobs._store, digest)  # type: ignore[attr-defined]
        seen += any(p.startswith("torn") for p in problems(history, parts))
        obstore.put(parts.blobs._store, digest, kept)  # type: ignore[attr-defined]
    where = {"p": plant, "d": digest}
    with parts.database.engine.connect() as connection:
        connection.execute(
            text("UPDATE episodes SET digest = 'gone' WHERE plant = :p AND digest = :d"), where
        )
        connection.commit()
        seen += any(p.startswith("lost") for p in problems(history, parts))
        connection.execute(
            text("UPDATE episodes SET digest = :d WHERE plant = :p AND digest = 'gone'"), where
        )
        connection.commit()
    with writing(parts.database) as tx:
        tx.log.append(
            ActorContext("bench", "2026-01-01T00:00:00.000000Z"),
            "episode:ingested",
            plant=plant,
            subject=digest,
            facts={},
        )
    seen += any(p.startswith("doubled") for p in problems(history, parts))
    return f"{seen} of 3 found"
