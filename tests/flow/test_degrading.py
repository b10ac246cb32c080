"""What the service stands on goes away and comes back: it says so, refuses what it cannot keep, and
recovers without help."""

import json
import time
from contextlib import closing

import pytest
from sqlalchemy import make_url

from tests.flow.test_failures import until
from tests.http.test_http import request
from tests.support.made import episode_bytes, plant_document, save
from tests.support.service import Service
from tests.support.storage import Storage, scaled
from tests.support.tcp_proxy import TcpProxy
from trueup_client import Client, Problem
from trueup_service.actions.register_plant import register_plant
from trueup_service.actor_context import ActorContext
from trueup_service.registry.transaction import ReadTransaction, writing

FAST = {"TRUEUP_TAKEOVER_INTERVAL_S": "0.2", "TRUEUP_DATABASE_POOL": "8"}


@pytest.fixture(scope="module")
def reached(postgres, s3, tmp_path_factory):
    """A service whose database and store are reached over lines of ours."""
    folder = tmp_path_factory.mktemp("reached")
    storage = scaled(folder / "data", postgres, s3)
    url = make_url(storage.environment["TRUEUP_DATABASE_URL"])
    if url.port is None:
        pytest.fail("the tests' PostgreSQL must listen on a port")
    database, store = (
        TcpProxy(url.port),
        TcpProxy(int(storage.environment["TRUEUP_S3_ENDPOINT"].rpartition(":")[2])),
    )
    over = {
        "TRUEUP_DATABASE_URL": url.set(host="127.0.0.1", port=database.port).render_as_string(
            hide_password=False
        ),
        "TRUEUP_S3_ENDPOINT": f"http://127.0.0.1:{store.port}",
    }
    service = Service(Storage("scaled", storage.environment | over | FAST))
    with service.running(kept=True), closing(Client(service.url, timeout_s=30)) as client:
        client.register_plant(plant_document("p"))
        yield service, client, database, store, folder
    database.close()
    store.close()


@pytest.fixture
def lines(reached):
    """The same with both lines up, before and after."""
    yield reached
    reached[2].set("up")
    reached[3].set("up")


def readiness(service):
    status, _, body = request(service, "GET", "/readyz")
    return status, json.loads(body)["checks"]


def test_a_database_that_goes_away_is_told_and_found_again(lines):
    service, client, database, _, folder = lines
    assert readiness(service)[0] == 200
    client.upload_episode("p", save(folder, "a.mcap", episode_bytes(1)))
    database.set("down")
    status, checks = readiness(service)
    assert (status, checks["database"].startswith("fails"), checks["blobs"]) == (503, True, "ok")
    with pytest.raises(Problem) as refused:
        client.serving("p")
    assert (refused.value.status, refused.value.code) == (503, "not-ready")
    time.sleep(1.5)  # the worker sees it, too
    database.set("up")
    until(lambda: readiness(service)[0] == 200, 20)
    assert client.serving("p").generation == 1
    job = client.submit("p", {"kind": "fit", "method": "identify"})["id"]
    until(lambda: client.job(job)["state"] == "succeeded", 60)


@pytest.mark.parametrize("state", ["down", "away"])
def test_a_store_that_does_not_answer_is_told_and_nothing_is_acknowledged(lines, state):
    service, client, _, store, folder = lines
    episode = save(folder, "a.mcap", episode_bytes(41 if state == "down" else 42))
    store.set(state)
    status, checks = readiness(service)
    assert (status, checks["database"], checks["blobs"].startswith("fails")) == (503, "ok", True)
    with pytest.raises(Problem) as refused:
        client.upload_episode("p", episode)
    assert (refused.value.status, refused.value.code) == (503, "store-away")
    assert client.serving("p").generation == 1  # what needs no store goes on
    store.set("up")
    before = {e["digest"] for e in client.episodes("p")}
    assert (
        {client.upload_episode("p", episode)["digest"]} | before
        == {e["digest"] for e in client.episodes("p")}
        > before
    )
    assert readiness(service)[0] == 200


def test_a_slow_store_makes_an_upload_slow_and_nothing_else(lines):
    _, client, _, store, folder = lines
    store.delay_s, before, began = 0.3, store.carried, time.monotonic()
    client.upload_episode("p", save(folder, "a.mcap", episode_bytes(30)))
    assert time.monotonic() - began >= store.delay_s
    carried = store.carried
    assert carried > before
    assert client.serving("p").generation == 1
    assert store.carried == carried  # it does not ask the store, so it does not wait for it
    store.delay_s = 0.0


def test_a_clock_that_goes_back_changes_no_order(storage):
    """Generations, the log's order and history are those of what happened, whatever the clock
    says."""
    from tests.stores.test_registry import decide
    from trueup_service.actions.move_pointer import promote_decision
    from trueup_service.registry.records import ArtifactRecord

    parts = storage.build()
    late, early = (
        ActorContext("t", "2030-01-01T00:00:00.000000Z"),
        ActorContext("t", "2020-01-01T00:00:00.000000Z"),
    )
    with writing(parts.database) as tx:
        register_plant(tx, plant_document("p"), late)
    with writing(parts.database) as tx:
        digest = "1" * 64
        tx.artifacts.add(
            ArtifactRecord("p", 2, digest, "identified", "{}", None, None, early.now, "t")
        )
        moved = promote_decision(tx, "p", decide(tx, "p", digest), 1, {}, early)
    assert (moved.generation, moved.at) == (2, late.now)
    with parts.database.read() as connection:
        tx = ReadTransaction(connection)
        assert tx.serving.at_time("p", late.now).generation == 2
        assert [e.sequence for e in tx.log.entries(0, 99)] == list(range(1, tx.log.tree().size + 1))
    parts.close()
