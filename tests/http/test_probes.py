"""Thirteen questions that a registry should answer safely, as they were asked of a widely used one,
which answers three."""

import hashlib
import json
import socket
import uuid

import pytest

from tests.http.test_http import accepted, problem, request
from tests.support.made import episode_bytes, identified, plant_document, save
from trueup.canonical import canonical_bytes
from trueup_client import Problem

JSON = {"Content_Type": "application/json"}


@pytest.fixture
def moved(service, client):
    """A plant whose second version serves, and the decision that let it."""
    plant = f"p{uuid.uuid4().hex[:12]}"
    client.register_plant(plant_document(plant))
    decision = accepted(client, plant, 1.2)
    client.promote(plant, decision, 1)
    return plant, decision


def test_1_a_move_that_expects_an_older_position_is_refused(client, moved):
    with pytest.raises(Problem) as refused:
        client.roll_back(moved[0], 1)
    assert refused.value.code == "pointer-moved"


def test_2_bytes_that_are_not_what_their_digest_names_are_refused(service, moved):
    found = problem(
        service, "PUT", f"/v1/blobs/{'0' * 64}", b"bytes", Content_Type="application/octet-stream"
    )
    assert found[:2] == (422, "digest-mismatch")


def test_3_the_bytes_of_what_is_registered_cannot_be_replaced(service, client, moved):
    digest = client.serving(moved[0]).artifact
    before = request(service, "GET", f"/v1/plants/{moved[0]}/artifacts/{digest}/manifest")[2]
    assert (
        request(
            service, "PUT", f"/v1/plants/{moved[0]}/artifacts/{digest}/manifest", b"{}", **JSON
        )[0]
        == 405
    )
    assert (
        request(service, "GET", f"/v1/plants/{moved[0]}/artifacts/{digest}/manifest")[2] == before
    )


def test_4_what_serves_cannot_be_deleted(service, client, moved):
    serving = client.serving(moved[0])
    assert problem(service, "DELETE", f"/v1/plants/{moved[0]}/artifacts/{serving.artifact}")[
        :2
    ] == (409, "kept")
    assert client.serving(moved[0]) == serving


def test_5_one_key_makes_one_version_and_is_refused_for_another(service, client, moved):
    one, other = (identified(moved[0], k).manifest for k in (1.31, 1.32))
    path, key = f"/v1/plants/{moved[0]}/artifacts", uuid.uuid4().hex
    answers = [request(service, "POST", path, one, Idempotency_Key=key, **JSON) for _ in range(2)]
    assert answers[0][2] == answers[1][2]
    assert problem(service, "POST", path, other, Idempotency_Key=key, **JSON)[:2] == (
        409,
        "idempotency-key-reused",
    )
    assert [a["version"] for a in client.artifacts(moved[0])] == [1, 2, 3]


def test_6_an_answer_that_has_not_changed_is_not_sent_again(service, moved):
    status, headers, _ = request(service, "GET", f"/v1/plants/{moved[0]}/serving")
    assert status == 200
    assert (
        request(service, "GET", f"/v1/plants/{moved[0]}/serving", If_None_Match=headers["etag"])[0]
        == 304
    )


def test_7_what_served_when_is_kept(client, moved):
    assert [(s.generation, s.version, s.decision) for s in client.history(moved[0])] == [
        (1, 1, None),
        (2, 2, moved[1]),
    ]


def test_8_the_interface_describes_itself(service):
    assert json.loads(request(service, "GET", "/openapi.json")[2])["openapi"].startswith("3.")


def test_9_who_did_what_stands_on_every_change(client, moved):
    entries = list(client.audit(moved[0]))
    assert {e["actor"] for e in entries} == {"admin for tester"}
    assert [e["facts"]["decision"] for e in entries if e["kind"] == "pointer:moved"] == [moved[1]]


def test_10_nothing_serves_that_was_not_judged(client, moved):
    with pytest.raises(Problem) as refused:
        client.promote(moved[0], "0" * 64, 2)
    assert refused.value.status == 404
    assert client.serving(moved[0]).generation == 2


@pytest.mark.parametrize(
    ("name", "of_blob"),
    [
        ("../../etc/passwd", 404),
        ("..%2f..%2fetc%2fpasswd", 404),
        ("%2e%2e", 422),  # one segment, and no digest
        ("a/b", 404),
        ("file:///etc/passwd", 404),
    ],
)
def test_11_a_name_is_never_a_path(service, name, of_blob):
    assert request(service, "GET", f"/v1/plants/{name}/serving")[0] == 404
    assert request(service, "GET", f"/v1/blobs/{name}")[0] == of_blob


def test_12_no_address_that_a_client_gives_is_asked(service, client, moved):
    plant, sound = moved[0], json.loads(identified(moved[0], 1.24).manifest)
    with socket.create_server(("127.0.0.1", 0)) as listening:
        source = f"http://127.0.0.1:{listening.getsockname()[1]}/model"
        known = {**sound["provenance"], "uri": source}
        manifest = canonical_bytes({**sound, "source": source, "provenance": known})
        candidate = client.add_artifact(plant, manifest)["digest"]
        kept = request(service, "GET", f"/v1/plants/{plant}/artifacts/{candidate}/manifest")[2]
        assert kept == manifest  # words like others, whatever they name
        gate = client.gate_in_force(plant)["digest"]
        job = client.submit(plant, {"kind": "gate", "candidate": candidate, "gate": gate})
        assert client.wait(job["id"])["state"] == "succeeded"
        body = json.dumps({"kind": "fit", "method": "identify", "source": source})
        refused = problem(service, "POST", f"/v1/plants/{plant}/jobs", body, **JSON)
        assert refused[:2] == (422, "invalid-request")
        listening.setblocking(False)
        with pytest.raises(BlockingIOError):  # nobody has come
            listening.accept()


def test_13_the_same_bytes_are_the_same_thing_and_come_back_as_they_were(client, moved, tmp_path):
    data = episode_bytes(77)
    first, again = (
        client.upload_episode(moved[0], save(tmp_path, "e.mcap", data)) for _ in range(2)
    )
    assert first == again
    client.download_episode(moved[0], first["digest"], tmp_path / "back")
    assert hashlib.sha256((tmp_path / "back").read_bytes()).hexdigest() == first["digest"]
