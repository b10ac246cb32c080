"""Killed workers, killed servers, restarts: nothing acknowledged is lost, nothing happens twice."""

import itertools
import signal
import subprocess
import sys
import threading
import time
from contextlib import closing

import numpy as np
import pytest
import sqlalchemy as sa

from tests.support.gates import LENIENT
from tests.support.made import T0_NS, episode_bytes, mcap_bytes, plant_document, save
from tests.support.service import ROOT, Service, free_port, kill
from tests.support.storage import Storage, embedded, scaled
from trueup.episode.role import Role
from trueup.ledger.audit import AuditEntry, rebuild
from trueup.model.plant import Plant
from trueup_client import Client, Problem, Unreachable
from trueup_client.problem import ClientError

LONG_SAMPLES = (
    60_000  # about a second of reading and fitting: long enough to be killed in the middle of
)


@pytest.fixture(scope="module")
def long_episode(tmp_path_factory):
    plant, rng = Plant.from_document(plant_document()), np.random.default_rng(0)
    data = mcap_bytes(
        plant.layout,
        rng.normal(size=(LONG_SAMPLES, 2)),
        rng.uniform(-1, 1, (LONG_SAMPLES, 1)),
        start_ns=T0_NS,
    )
    return save(tmp_path_factory.mktemp("long"), "long.mcap", data)


@pytest.fixture(scope="module", params=["embedded", "scaled"])
def server(request, tmp_path_factory):
    """A server without a worker."""
    folder, given = tmp_path_factory.mktemp("server"), request.getfixturevalue
    service = Service(
        embedded(folder)
        if request.param == "embedded"
        else scaled(folder, given("postgres"), given("s3"))
    )
    service.start_server()
    yield service
    service.stop()


class Lone:
    """One test's plant on a server, and its workers."""

    def __init__(self, service, plant):
        self.service, self.plant = service, plant
        self.client = Client(service.url, actor="tester")
        self.client.register_plant(plant_document(plant))
        self.workers = []

    def start_worker(self):
        self.workers.append(self.service.start_worker())
        return self.workers[-1]

    def begun(self, episode):
        """A fit that is under way."""
        self.client.upload_episode(self.plant, episode)
        return self.client.submit(self.plant, {"kind": "fit", "method": "residual"})["id"]

    def count(self, kind):
        return sum(e["kind"] == kind for e in self.client.audit(self.plant))

    def end(self):
        self.client.close()
        self.service.stop(self.workers)


_plants = itertools.count()


@pytest.fixture
def lone(server):
    found = Lone(server, f"p{next(_plants)}")
    yield found
    found.end()


def until(condition, seconds=60.0):
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        found = condition()
        if found:
            return found
        time.sleep(0.005)
    raise AssertionError("it did not come about")


def test_a_killed_workers_job_is_finished_by_another_once(lone, long_episode):
    client = lone.client
    first = lone.start_worker()
    job = lone.begun(long_episode)
    until(lambda: client.job(job)["state"] == "running")
    kill(first)
    assert client.job(job)["state"] == "running"
    lone.start_worker()
    done = client.wait(job)
    assert done["state"] == "succeeded"
    assert [a["version"] for a in client.artifacts(lone.plant)] == [1, 2]
    assert (lone.count("artifact:added"), lone.count("job:finished")) == (1, 1)


def test_a_living_worker_takes_over_by_itself(lone, long_episode):
    client = lone.client
    runs_it = lone.start_worker()
    job = lone.begun(long_episode)
    until(lambda: client.job(job)["state"] == "running")
    lone.start_worker()
    kill(runs_it)
    again = client.submit(lone.plant, {"kind": "fit", "method": "identify"})["id"]
    assert client.wait(job)["state"] == client.wait(again)["state"] == "succeeded"
    assert lone.count("job:finished") == 2


def given_up_on(service, job, times=1):
    """As the job engine leaves what it tried in vain, in the database itself."""
    engine = service.storage.build().database.engine
    schema = "dbos" if engine.dialect.name == "postgresql" else None
    status, given = (
        sa.Table(name, sa.MetaData(), schema=schema, autoload_with=engine)
        for name in ("workflow_status", "workflow_input")
    )
    with engine.begin() as connection:
        connection.execute(
            status.update().where(status.c.workflow_uuid == job).values(status="ERROR")
        )
        for table in (status, given):
            rows = (
                connection.execute(table.select().where(table.c.workflow_uuid == job))
                .mappings()
                .all()
            )
            for attempt in range(1, times):
                connection.execute(
                    table.insert(), [{**row, "workflow_uuid": f"{job}-{attempt}"} for row in rows]
                )
    engine.dispose()


def test_what_the_engine_gave_up_on_is_begun_again(lone, long_episode):
    client = lone.client
    job = lone.begun(long_episode)
    given_up_on(lone.service, job, times=2)
    lone.start_worker()
    until(lambda: client.job(job)["state"] == "succeeded")
    assert (lone.count("artifact:added"), lone.count("job:finished")) == (1, 1)


def test_what_it_gives_up_on_again_and_again_fails_and_says_so(lone, long_episode):
    client = lone.client
    job = lone.begun(long_episode)
    given_up_on(lone.service, job, times=5)
    lone.start_worker()
    until(lambda: client.job(job)["state"] == "failed")
    assert client.job(job)["result"]["problem"]["code"] == "given-up"
    assert lone.count("artifact:added") == 0


def test_a_running_job_can_be_cancelled(lone, long_episode):
    client = lone.client
    lone.start_worker()
    job = lone.begun(long_episode)
    until(lambda: client.job(job)["state"] == "running")
    client.cancel(job)
    until(lambda: client.job(job)["state"] == "cancelled")
    assert [a["version"] for a in client.artifacts(lone.plant)] == [1]
    assert client.job(job)["result"]["problem"]["code"] == "cancelled"


def test_a_waiting_job_is_cancelled_at_once_and_never_runs(lone, long_episode):
    client = lone.client
    job = lone.begun(long_episode)
    assert client.cancel(job)["state"] == "cancelled"
    other = client.submit(lone.plant, {"kind": "fit", "method": "identify"})["id"]
    lone.start_worker()
    client.wait(other)
    assert client.job(job)["state"] == "cancelled"
    assert client.job(job)["reads"] == {}


def test_a_job_waits_out_a_whole_restart(lone, long_episode):
    client = lone.client
    job = lone.begun(long_episode)
    lone.service.stop()
    lone.service.start_server(worker=True)
    assert client.wait(job)["state"] == "succeeded"
    lone.service.stop()
    lone.service.start_server()


def test_a_killed_server_has_lost_nothing_that_it_acknowledged(storage, tmp_path):
    service = Service(storage)
    acknowledged: dict[str, bytes] = {}
    server = service.start_server()
    try:
        setup = Client(service.url)
        setup.register_plant(plant_document("p"))
        setup.close()
        stop = threading.Event()

        def upload(worker):
            client = Client(service.url, timeout_s=5)
            for n in range(1000):
                if stop.is_set():
                    break
                data = episode_bytes(worker * 1000 + n, samples=20, role=Role.REFERENCE)
                try:
                    found = client.upload_episode("p", save(tmp_path, f"{worker}-{n}.mcap", data))
                except ClientError:
                    continue
                acknowledged[found["digest"]] = data
            client.close()

        threads = [threading.Thread(target=upload, args=(n,)) for n in range(3)]
        for thread in threads:
            thread.start()
        for enough in (3, 6):
            until(lambda enough=enough: len(acknowledged) >= enough)
            kill(server)
            server = service.start_server()
        until(lambda: len(acknowledged) >= 9)
        stop.set()
        for thread in threads:
            thread.join()
        kill(server)
        service.start_server()
        client = Client(service.url)
        kept = {e["digest"] for e in client.episodes("p")}
        assert set(acknowledged) <= kept
        for digest, data in acknowledged.items():
            client.download_episode("p", digest, tmp_path / "back")
            assert (tmp_path / "back").read_bytes() == data
        assert rebuild(AuditEntry(**e) for e in client.audit()).size == 1 + len(kept)
        client.close()
    finally:
        service.stop()


def test_two_servers_on_one_database_agree_at_once(postgres, s3, tmp_path):
    storage = scaled(tmp_path / "a", postgres, s3)
    first = Service(storage)
    second = Service(
        Storage("scaled", storage.environment | {"TRUEUP_DATA_DIR": str(tmp_path / "b")})
    )
    try:
        first.start_server()
        second.start_server()
        one, other = Client(first.url), Client(second.url)
        one.register_plant(plant_document("p"))
        assert other.serving("p") == one.serving("p")
        watched = []
        watcher = threading.Thread(target=lambda: watched.append(second_look(second.url)))
        watcher.start()
        first.start_worker()
        promoted = promote(one, tmp_path)
        assert other.serving("p") == promoted
        watcher.join(timeout=20)
        assert watched == [promoted.generation]
        back = other.roll_back("p", promoted.generation)
        assert one.serving("p") == back
        one.close()
        other.close()
    finally:
        first.stop()
        second.stop()


def second_look(url):
    client = Client(url)
    changes = client.watch("p")
    next(changes)
    found = next(changes).generation
    changes.close()
    client.close()
    return found


def promote(client, folder):
    for seed, role in ((0, Role.ADAPTATION), (1, Role.VALIDATION)):
        client.upload_episode("p", save(folder, f"{seed}.mcap", episode_bytes(seed, role=role)))
    candidate = client.wait(client.submit("p", {"kind": "fit", "method": "identify"})["id"])[
        "result"
    ]["artifact"]
    gate = client.declare_gate("p")["digest"]
    decision = client.wait(
        client.submit("p", {"kind": "gate", "candidate": candidate, "gate": gate})["id"]
    )["result"]["decision"]
    return client.promote("p", decision, client.serving("p").generation)


def test_a_damaged_artifact_is_not_served_again(tmp_path):
    """The switchback test fails, the pointer stays, and the answer says why and what can serve."""
    service = Service(embedded(tmp_path / "data"))
    with service.running():
        client = Client(service.url)
        client.register_plant(plant_document("p"))
        for seed, role in ((0, Role.ADAPTATION), (1, Role.VALIDATION)):
            client.upload_episode(
                "p", save(tmp_path, f"{seed}.mcap", episode_bytes(seed, role=role))
            )
        gate = client.declare_gate("p", LENIENT)
        for method in ("residual", "identify"):
            candidate = client.wait(client.submit("p", {"kind": "fit", "method": method})["id"])[
                "result"
            ]["artifact"]
            decision = client.wait(
                client.submit(
                    "p", {"kind": "gate", "candidate": candidate, "gate": gate["digest"]}
                )["id"]
            )
            client.promote("p", decision["result"]["decision"], client.serving("p").generation)
        arrays = client.version("p", 2)["arrays"]
        blob = next((tmp_path / "data" / "blobs").glob(f"{arrays[:2]}/{arrays[2:]}"))
        blob.chmod(0o600)
        blob.write_bytes(blob.read_bytes()[:-1] + b"\x01")
        with pytest.raises(Problem) as refused:
            client.roll_back("p", 3)
        assert refused.value.code == "switchback-failed"
        assert client.serving("p").generation == 3
        # the next older one is named, and reached by one call
        older = refused.value.facts["next"]
        assert (older["generation"], older["version"]) == (1, 1)
        assert "`to_generation` 1" in refused.value.hint
        back = client.roll_back("p", 3, to_generation=older["generation"])
        assert (back.artifact, back.generation) == (older["artifact"], 4)
        client.close()


def test_a_client_says_so_when_nobody_answers():
    client = Client("http://127.0.0.1:9")
    with pytest.raises(Unreachable):
        client.plant("p")


def test_a_command_that_is_ended_ends_the_service_beside_it(tmp_path):
    url = f"http://127.0.0.1:{free_port()}"
    look = [
        sys.executable,
        "-m",
        "trueup_cli.main",
        "look",
        "--data",
        str(tmp_path),
        "--no-browser",
        "--url",
        url,
    ]
    with subprocess.Popen(
        look, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, cwd=ROOT
    ) as looking:
        try:
            # the service beside may say something before
            assert any(url in line for line in looking.stdout)
        finally:
            looking.terminate()
    assert looking.returncode == 128 + signal.SIGTERM
    with closing(Client(url)) as client, pytest.raises(Unreachable):
        client.is_ready()
