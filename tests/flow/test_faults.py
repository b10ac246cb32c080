"""Every step towards the disk and the database fails once, or the process dies there: nothing
acknowledged is lost, nothing is torn."""

import http.client
import json
import uuid

import pytest

from tests.http.test_http import accepted, request
from tests.support.faults import arm
from tests.support.gates import LENIENT
from tests.support.made import episode_bytes, plant_document
from tests.support.service import Service, kill
from trueup.ledger.verification import verify
from trueup_client import Client
from trueup_service.installation import Installation, lost_jobs

FAULTY = "tests.support.faults"
JSON = {"Content_Type": "application/json"}
MOST_STEPS = 40  # no request has as many
# the status of a request that meets a fault; of a full disk a database only says that it failed
TOLD = {"EIO": {503}, "ENOSPC": {507, 503}, "kill": {0}}


class Faulty:
    """A server with faults in it, started again when it has died."""

    def __init__(self, storage, folder):
        self.fault = folder / "fault"
        self.storage = storage
        self.service = Service(storage, checkpoint_interval_s=3600)
        self.child = self.service.start_server(module=FAULTY)

    def send(self, method, path, body, key):
        """Status of a request; 0 where the server died."""
        try:
            return request(self.service, method, path, body, **JSON, Idempotency_Key=key)
        except (OSError, http.client.HTTPException):
            self.child.wait(timeout=10)
            self.child = self.service.start_server(module=FAULTY)
            return 0, {}, b""

    def everywhere(self, what, method, path, body):
        """A fault at each step of a request in turn, each time repeated until it is done; how many
        steps there were.

        `body(n)` is the body of the n-th request. Nothing may be acknowledged before its last step
        is done.
        """
        for at in range(1, MOST_STEPS):
            key, sent = uuid.uuid4().hex, body(at)
            arm(self.fault, what, at)
            status, _, _ = self.send(method, path, sent, key)
            struck = not self.fault.exists()
            self.fault.unlink(missing_ok=True)
            assert status in (TOLD[what] if struck else (200, 201)), (what, at, status)
            again, _, answer = self.send(method, path, sent, key)
            assert again in (200, 201), (what, at, again, answer[:300])
            if not struck:
                return at - 1
        raise AssertionError("the request has too many steps")

    def is_whole(self):
        """Whether the log tells all that there is, and no more, in an installation that is looked
        at beside the server."""
        parts = self.storage.build()
        found = verify(Installation(parts.database, parts.blobs)).findings + lost_jobs(parts)
        parts.close()
        return found == []


@pytest.fixture
def faulty(storage, tmp_path, monkeypatch):
    monkeypatch.setenv("FAULT_FILE", str(tmp_path / "fault"))
    found = Faulty(storage, tmp_path)
    client = Client(found.service.url)
    client.register_plant(plant_document("p"))
    client.close()
    yield found
    kill(found.child)
    found.service.stop()


def gate(at):
    return json.dumps(LENIENT | {"scoring": {"horizon_s": 2.0 + at / 100, "windows": "first"}})


@pytest.mark.parametrize(
    ("storage", "what"),
    [("embedded", "EIO"), ("embedded", "ENOSPC"), ("scaled", "EIO")],
    indirect=["storage"],
)
def test_whatever_fails_the_caller_is_told_and_the_same_request_again_is_done_once(faulty, what):
    uploads = faulty.everywhere(
        what, "POST", "/v1/plants/p/episodes", lambda at: episode_bytes(at, 60)
    )
    gates = faulty.everywhere(what, "POST", "/v1/plants/p/gates", gate)
    assert uploads >= gates + 2  # an upload has its bytes to make durable before the row
    assert gates >= 2
    client = Client(faulty.service.url)
    entries = [(e["kind"], e["subject"]) for e in client.audit()]
    assert len(entries) == len(set(entries))
    assert (
        [k for k, _ in entries].count("episode:ingested")
        == len(list(client.episodes("p")))
        == uploads + 1
    )
    assert len(list(client.audit("p"))) == 1 + uploads + 1 + gates + 1
    client.close()
    assert faulty.is_whole()


def test_a_server_that_dies_at_any_step_has_lost_nothing_and_done_nothing_twice(faulty):
    uploads = faulty.everywhere(
        "kill", "POST", "/v1/plants/p/episodes", lambda at: episode_bytes(at, 60)
    )
    client = Client(faulty.service.url)
    assert len(list(client.episodes("p"))) == uploads + 1
    client.close()
    assert faulty.is_whole()


def test_a_pointer_that_cannot_be_written_does_not_move(faulty):
    """A failure, or a death, before the commit and behind it."""
    client, generation = Client(faulty.service.url), 1
    worker = faulty.service.start_worker()
    for at in (1, 2):
        decision = accepted(client, "p", 1.0 + at / 10)
        promotion = {"decision": decision, "expected_generation": generation}
        for what, path, body in (
            ("EIO", "promote", promotion),
            ("kill", "rollback", {"expected_generation": generation + 1}),
        ):
            arm(faulty.fault, what, at)
            asked = "POST", f"/v1/plants/p/serving/{path}", json.dumps(body), uuid.uuid4().hex
            assert faulty.send(*asked)[0] in TOLD[what]
            assert client.serving("p").generation == (generation if at == 1 else generation + 1)
            assert faulty.send(*asked)[0] == 200
            generation += 1
            assert client.serving("p").generation == generation
    kill(worker)
    client.close()
    assert faulty.is_whole()
