"""Events reach webhooks: signed, in order, again until they are accepted, and nowhere else."""

import json
import os
import threading
import time
from contextlib import closing

import pytest
from cloudevents.core.bindings.http import HTTPMessage, from_structured_event
from cloudevents.core.formats.json import JSONFormat
from sqlalchemy import select, update
from standardwebhooks import Webhook as Verifier
from standardwebhooks import WebhookVerificationError

from tests.support.forks import run
from tests.support.gates import LENIENT
from tests.support.made import episode_bytes, plant_document, save
from tests.support.receiver import receiving
from tests.support.service import ROOT, Service, command, kill
from tests.support.storage import requested
from trueup.episode.role import Role
from trueup_client import Client, Problem
from trueup_service.registry.tables import webhook_cursors

PUBLIC = "https://registry.example.com"
EVENTS = ["episode", "alarm", "diagnosis", "decision", "promotion", "rollback"]


@pytest.fixture(scope="module", params=["embedded", "scaled"])
def service(request, tmp_path_factory):
    storage = requested(request, tmp_path_factory.mktemp("service"))
    settings = {
        "webhook_hosts": "127.0.0.1,localhost,*.example.com",
        "webhook_private_ranges": "127.0.0.0/8",
        "public_url": PUBLIC,
    }
    with Service(storage, **settings).running() as running:
        yield running


@pytest.fixture
def receiver():
    with receiving() as running:
        yield running


@pytest.fixture
def declared(client, receiver, request):
    """Declares webhooks to the receiver, and removes them when the test ends."""
    names = []

    def declare(name, **more):
        names.append(name)
        return client.declare_webhook(name, receiver.url, **{"events": EVENTS, **more})

    yield declare
    for name in names:
        if client.webhook(name)["state"] != "removed":
            client.remove_webhook(name)


def upload(client, plant, seed, folder, role=Role.ADAPTATION):
    return client.upload_episode(
        plant, save(folder, f"{plant}-{seed}.mcap", episode_bytes(seed, role=role))
    )


def read(request):
    """The event of a request, as the SDK of CloudEvents reads it."""
    return from_structured_event(HTTPMessage(request.headers, request.body), JSONFormat())


def until(condition):
    end = time.monotonic() + 30
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.05)


def test_a_whole_correction_is_told_signed_and_in_order(client, receiver, declared, tmp_path):
    secret = declared("all", plant=None)["secret"]
    client.register_plant(plant_document("told"))
    for seed, role in ((0, Role.ADAPTATION), (1, Role.VALIDATION)):
        upload(client, "told", seed, tmp_path, role)
    gate = client.declare_gate("told", LENIENT)["digest"]
    job = client.wait(client.submit("told", {"kind": "diagnose"})["id"])
    trial = {"kind": "gate", "candidate": job["result"]["artifact"], "gate": gate}
    decision = client.wait(client.submit("told", trial)["id"])["result"]["decision"]
    client.promote("told", decision, 1)
    client.roll_back("told", 2)
    requests = receiver.until(6)
    events = [read(r) for r in requests]
    assert [e.get_type() for e in events] == [
        "trueup.episode.ingested",
        "trueup.episode.ingested",
        "trueup.diagnosis.finished",
        "trueup.decision.made",
        "trueup.model.promoted",
        "trueup.model.rolled_back",
    ]
    log = client.audit_key().partition("+")[0]
    entries = {e["sequence"]: e for e in client.audit("told")}
    for request, event in zip(requests, events, strict=True):
        assert Verifier(secret).verify(request.body, request.headers)["id"] == event.get_id()
        with pytest.raises(WebhookVerificationError):
            Verifier(secret).verify(request.body + b" ", request.headers)
        entry = entries[event.get_data()["sequence"]]
        assert event.get_id() == request.headers["webhook-id"] == f"{log}-{entry['sequence']}"
        assert event.get_source() == f"urn:trueup:log:{log}"
        assert event.get_subject() == entry["subject"]
        assert event.get_time().isoformat() == entry["at"].replace("Z", "+00:00")
        assert event.get_extension("partitionkey") == "told"
        assert int(event.get_extension("sequence")) == entry["sequence"]
    data = [e.get_data() for e in events]
    assert data[2]["answer"] in data[2]["text"]
    assert data[2]["page"] == f"{PUBLIC}/plants/told/diagnoses/{job['id']}"
    assert (data[3]["accepted"], data[4]["decision"]) == (True, decision)
    assert data[5]["artifact"] == client.serving("told").artifact


def test_slack_gets_a_sentence_in_which_nothing_calls_anybody(
    client, service, receiver, declared, tmp_path
):
    declared("chat", form="slack", events=["alarm", "episode"])
    client.register_plant(plant_document("chatty"))
    with Client(service.url, actor="<!channel> & co") as rude:
        upload(rude, "chatty", 0, tmp_path)
    (request,) = receiver.until(1)
    message = json.loads(request.body)
    assert set(message) == {"text"}
    assert message["text"].startswith("*chatty*: admin for &lt;!channel&gt; &amp; co uploaded the")
    assert f"<{PUBLIC}/plants/chatty/episodes/" in message["text"]


def test_only_what_was_selected_of_whom_was_selected_is_told(client, receiver, declared, tmp_path):
    client.create_project("lab")
    client.register_plant(plant_document("in-lab"), project="lab")
    client.register_plant(plant_document("outside"))
    declared("of-lab", project="lab", events=["episode"])
    declared("of-plant", plant="outside", events=["decision"])
    for plant in ("in-lab", "outside"):
        upload(client, plant, 0, tmp_path)
    client.test_webhook("of-plant")
    events = [read(r) for r in receiver.until(2)]
    assert {(e.get_type(), e.get_data()["plant"]) for e in events} == {
        ("trueup.episode.ingested", "in-lab"),
        ("trueup.webhook.tested", None),
    }
    size = max(e["sequence"] for e in client.audit())
    until(lambda: {client.webhook(n)["sent"] for n in ("of-lab", "of-plant")} == {size})
    assert len(receiver.requests) == 2


def test_a_refused_event_is_sent_again_and_holds_up_its_own_plant_alone(
    client, receiver, declared, tmp_path
):
    for plant in ("held", "free"):
        client.register_plant(plant_document(plant))
    declared("retried", events=["episode"])
    refuses = threading.Event()
    refuses.set()
    receiver.answer = lambda r: (
        500 if refuses.is_set() and json.loads(r.body)["partitionkey"] == "held" else 204
    )
    for seed in range(3):
        for plant in ("held", "free"):
            upload(client, plant, seed, tmp_path)

    def accepted(plant):
        seen = [json.loads(r.body) for r in list(receiver.requests)]
        return [e["data"]["sequence"] for e in seen if e["partitionkey"] == plant]

    until(lambda: len(accepted("free")) == 3 and len(accepted("held")) >= 1)
    until(lambda: client.webhook("retried")["state"] == "failing")
    shown = client.webhook("retried")
    assert shown["problem"] == "it answered 500"
    assert shown["due_at"] is not None
    assert len(set(accepted("held"))) == 1
    refuses.clear()
    client.resume_webhook("retried")
    until(lambda: len(set(accepted("held"))) == 3)
    assert accepted("held") == sorted(accepted("held"))
    assert accepted("free") == sorted(set(accepted("free")))  # none of them twice
    until(lambda: client.webhook("retried")["state"] == "sending")


def test_it_is_tried_again_without_anybody_asking(client, receiver, declared, tmp_path):
    client.register_plant(plant_document("again"))
    declared("patient", events=["episode"])
    answers = iter([500])
    receiver.answer = lambda _: next(answers, 204)
    upload(client, "again", 0, tmp_path)
    first, second = receiver.until(2)
    assert first.body == second.body
    assert first.headers["webhook-id"] == second.headers["webhook-id"]
    until(lambda: client.webhook("patient")["attempts"] == 0)


def test_one_that_is_gone_is_stopped_until_it_is_resumed_and_loses_nothing(
    client, receiver, declared, tmp_path
):
    client.register_plant(plant_document("gone"))
    declared("leaving", events=["episode"])
    receiver.answer = lambda _: 410
    upload(client, "gone", 0, tmp_path)
    until(lambda: client.webhook("leaving")["state"] == "stopped")
    upload(client, "gone", 1, tmp_path)
    (stopped,) = [e for e in client.audit() if e["kind"] == "webhook:stopped"]
    assert stopped["facts"]["because"] == "it answered 410"
    receiver.answer = lambda _: 204
    before = len(receiver.requests)
    client.resume_webhook("leaving")
    assert [read(r).get_data()["episode"] for r in receiver.until(before + 2)[before:]] == [
        e["digest"] for e in reversed(list(client.episodes("gone")))
    ]
    # and all of it again, for whoever lost it
    client.resume_webhook("leaving", after=stopped["sequence"] - 2)
    receiver.until(before + 4)


def test_a_killed_worker_loses_no_event(client, service, receiver, declared, tmp_path):
    client.register_plant(plant_document("killed"))
    declared("survivor", events=["episode"])
    holds, arrived = threading.Event(), threading.Event()

    def answer(_):
        arrived.set()
        holds.wait(timeout=20)
        return 204

    receiver.answer = answer
    (worker,) = service.workers
    digests = [upload(client, "killed", seed, tmp_path)["digest"] for seed in range(4)]
    assert arrived.wait(timeout=20)
    kill(worker)
    holds.set()
    service.start_worker()
    size = max(e["sequence"] for e in client.audit())
    until(lambda: client.webhook("survivor")["sent"] == size)
    told = [read(r).get_data()["episode"] for r in receiver.requests]
    assert list(dict.fromkeys(told)) == digests


def test_redirects_are_not_followed(client, receiver, declared, tmp_path):
    client.register_plant(plant_document("moved"))
    declared("elsewhere", events=["episode"])
    receiver.answer = lambda _: (307, {"Location": f"{receiver.url}/other"})
    upload(client, "moved", 0, tmp_path)
    until(lambda: client.webhook("elsewhere")["state"] == "failing")
    assert "redirects are not followed" in client.webhook("elsewhere")["problem"]
    assert {r.path for r in receiver.requests} == {"/events"}


@pytest.mark.parametrize(
    "url",
    [
        "https://elsewhere.org/hook",
        "https://example.com.evil.org/",
        "https://127.0.0.2/",
        "ftp://127.0.0.1/",
        "https://user:word@127.0.0.1/",
        "https://127.0.0.1/#part",
        "https://127.0.0.1:port/",
        "https://127.0.0.1/a b",
        "file:///etc/passwd",
        "127.0.0.1",
    ],
)
def test_other_addresses_are_refused(client, url):
    with pytest.raises(Problem) as refused:
        client.declare_webhook("refused", url, ["episode"])
    assert (refused.value.status, refused.value.code) == (422, "webhook-refused")


def test_url_and_secret_stand_nowhere_else(client, service, receiver, declared, tmp_path):
    client.register_plant(plant_document("secret"))
    url = f"{receiver.url}/services/T000/B000/token-in-the-url"
    made = client.declare_webhook("hidden", url, ["episode"])
    upload(client, "secret", 0, tmp_path)
    assert receiver.until(1)[0].path.endswith("token-in-the-url")
    listed = map(list, (client.webhooks(), client.audit(), client.rows("webhooks")))
    shown = json.dumps([client.webhook("hidden"), *listed])
    backup = tmp_path / "backup"
    environment = {**os.environ, **service.storage.environment}
    assert run("trueup_cli.main", ["backup", str(backup)], environment, ROOT).returncode == 0
    files = b"".join(p.read_bytes() for p in backup.rglob("*") if p.is_file())
    for text in (made["secret"], "token-in-the-url"):
        assert text not in shown
        assert text.encode() not in files
    client.remove_webhook("hidden")
    with closing(service.storage.build()) as parts, parts.database.read() as connection:
        (row,) = connection.execute(
            select(webhook_cursors).where(webhook_cursors.c.webhook == "hidden")
        )
    assert (row.url, row.secret) == ("", "")


def test_a_changed_url_is_not_sent_to(client, service, receiver, declared, tmp_path):
    client.register_plant(plant_document("altered"))
    declared("altered", events=["episode"])
    with closing(service.storage.build()) as parts, parts.database.write() as connection:
        connection.execute(
            update(webhook_cursors)
            .where(webhook_cursors.c.webhook == "altered")
            .values(url=f"{receiver.url}/attacker")
        )
    upload(client, "altered", 0, tmp_path)
    until(lambda: client.webhook("altered")["state"] == "stopped")
    assert client.webhook("altered")["problem"] == "its URL is not the one that was declared"
    assert receiver.requests == []


def test_names_are_taken_once_and_removed_webhooks_stay_removed(client, declared):
    declared("once", events=["episode"])
    with pytest.raises(Problem, match="a webhook of that name"):
        declared("once", events=["episode"])
    client.remove_webhook("once")
    for call in (client.remove_webhook, client.test_webhook, client.resume_webhook):
        with pytest.raises(Problem, match="was removed"):
            call("once")
    with pytest.raises(Problem) as missing:
        client.webhook("nobody")
    assert missing.value.status == 404


def test_by_command(client, service, receiver):
    secret = command(service, "webhook", "add", "by-hand", receiver.url, "episode").stdout.strip()
    command(service, "webhook", "test", "by-hand")
    (request,) = receiver.until(1)
    Verifier(secret).verify(request.body, request.headers)
    assert "by-hand" in command(service, "webhook", "list").stdout
    command(service, "webhook", "resume", "by-hand")
    assert "removed" in command(service, "webhook", "remove", "by-hand").stdout


def test_a_service_without_allowed_hosts_sends_nothing(storage, receiver):
    with (
        Service(storage).running(worker=False) as running,
        Client(running.url) as client,
        pytest.raises(Problem, match="sends no webhooks"),
    ):
        client.declare_webhook("any", receiver.url, ["episode"])
