"""The service over HTTP, on both storages: what it accepts, refuses, repeats and remembers."""

import base64
import contextlib
import hashlib
import http.client
import json
import socket
import tempfile
import threading
import time
import uuid
from pathlib import Path

import numpy as np
import pytest

from tests.support.gates import IMPROVING, declare_following
from tests.support.made import episode_bytes, identified, mcap_bytes, plant_document, save
from tests.support.service import ADMIN, Service
from tests.support.storage import Storage, embedded
from trueup.artifact.artifact import pack
from trueup.chapter.data import PLANT as CHAPTER
from trueup.episode.role import Role
from trueup.model.plant import Plant
from trueup.model.predictor import Identified, LinearMap, Residual
from trueup_client import Client, DigestMismatch, Problem
from trueup_service.http.serve import listen


@pytest.fixture
def plant(client):
    name = f"p{uuid.uuid4().hex[:12]}"
    client.register_plant(plant_document(name))
    return name


KNOWN = {"Authorization": f"Bearer {ADMIN}"}


def request(service, method, path, body=None, **headers):
    """One request by hand: status, headers, body."""
    connection = http.client.HTTPConnection("127.0.0.1", service.port, timeout=60)
    headers = KNOWN | {k.replace("_", "-"): v for k, v in headers.items()}
    connection.request(
        method,
        path,
        body=body,
        headers={name: value for name, value in headers.items() if value is not None},
    )
    answer = connection.getresponse()
    found = answer.status, answer.headers, answer.read()
    connection.close()
    return found


def problem(service, method, path, body=None, **headers):
    status, answered, content = request(service, method, path, body, **headers)
    assert answered["content-type"] == "application/problem+json"
    document = json.loads(content)
    assert document["status"] == status
    assert document["request_id"] == answered["x-request-id"]
    assert document["hint"]
    return status, document["code"], document


# -- uploads


def test_an_episode_comes_back_as_it_was_sent(client, plant, tmp_path):
    data = episode_bytes(stage="MIL")
    found = client.upload_episode(plant, save(tmp_path, "e.mcap", data))
    assert (found["digest"], found["role"], found["size_bytes"]) == (
        hashlib.sha256(data).hexdigest(),
        "adaptation",
        len(data),
    )
    assert found["summary"]["samples"] == 200
    assert found["summary"]["conditions"] == {"stage": "MIL"}
    client.download_episode(plant, found["digest"], tmp_path / "back.mcap")
    assert (tmp_path / "back.mcap").read_bytes() == data


def test_the_same_bytes_are_the_same_episode(service, plant):
    path, data = f"/v1/plants/{plant}/episodes", episode_bytes()
    assert request(service, "POST", path, data)[0] == 201
    assert request(service, "POST", path, data)[0] == 200
    assert len(json.loads(request(service, "GET", path)[2])["items"]) == 1


def test_a_key_repeats_its_upload_and_refuses_other_bytes(service, plant):
    path, key = f"/v1/plants/{plant}/episodes", uuid.uuid4().hex
    first = request(service, "POST", path, episode_bytes(1), Idempotency_Key=key)
    again = request(service, "POST", path, episode_bytes(1), Idempotency_Key=key)
    assert (first[0], first[2]) == (again[0], again[2])
    assert problem(service, "POST", path, episode_bytes(2), Idempotency_Key=key)[:2] == (
        409,
        "idempotency-key-reused",
    )


def test_bytes_that_are_not_what_the_digest_says_are_refused_and_leave_nothing(service, plant):
    path, data = f"/v1/plants/{plant}/episodes", episode_bytes(3)
    wrong = base64.b64encode(hashlib.sha256(b"other").digest()).decode()
    assert problem(service, "POST", path, data, Content_Digest=f"sha-256=:{wrong}:")[:2] == (
        422,
        "digest-mismatch",
    )
    assert json.loads(request(service, "GET", path)[2])["items"] == []
    right = base64.b64encode(hashlib.sha256(data).digest()).decode()
    assert request(service, "POST", path, data, Content_Digest=f"sha-256=:{right}:")[0] == 201


def test_a_malformed_file_is_refused_with_rule_and_byte_within_a_second(service, plant):
    path = f"/v1/plants/{plant}/episodes"
    for data, code in (
        (b"", "malformed-mcap"),
        (b"junk" * 1000, "malformed-mcap"),
        (episode_bytes()[:-20], "malformed-mcap"),
    ):
        status, found, document = problem(service, "POST", path, data)
        assert (status, found) == (422, code)
        assert {"rule", "byte"} <= set(document["facts"])


def test_a_sound_file_that_is_no_episode_of_the_plant_is_refused(service, client):
    document = plant_document(f"p{uuid.uuid4().hex[:8]}") | {
        "topics": {"observation": "/elsewhere", "command": "/joint_commands"}
    }
    client.register_plant(document)
    status, code, found = problem(
        service, "POST", f"/v1/plants/{document['name']}/episodes", episode_bytes()
    )
    assert (status, code, found["facts"]["rule"]) == (422, "not-an-episode", "topic")
    assert "/joint_states" in found["detail"]


def test_an_upload_that_stops_half_way_leaves_nothing(service, plant):
    def sent(data, part):
        """What is answered to an upload of which only a part comes; empty if nothing is."""
        head = (
            f"POST /v1/plants/{plant}/episodes HTTP/1.1\r\nHost: 127.0.0.1\r\n"
            f"Authorization: Bearer {ADMIN}\r\nConnection: close\r\n"
            f"Content-Length: {len(data)}\r\n\r\n"
        )
        with socket.create_connection(("127.0.0.1", service.port), timeout=60) as raw:
            raw.sendall(head.encode() + data[:part])
            if part < len(data):
                raw.shutdown(socket.SHUT_WR)
            return raw.makefile("rb").read()

    def listed():
        return json.loads(request(service, "GET", f"/v1/plants/{plant}/episodes")[2])["items"]

    data = episode_bytes(samples=4000)
    assert not sent(data, len(data) // 2).startswith(b"HTTP/1.1 2")
    assert listed() == []
    # the same bytes, whole, are taken: it was the other half that was missing
    assert sent(data, len(data)).startswith(b"HTTP/1.1 201 ")
    assert [e["digest"] for e in listed()] == [hashlib.sha256(data).hexdigest()]


def test_an_upload_over_the_limit_is_refused_while_it_streams(tmp_path):
    """Without a Content-Length the limit is held by counting."""
    storage = embedded(tmp_path / "data")
    service = Service(
        Storage("small", storage.environment | {"TRUEUP_UPLOAD_LIMIT_BYTES": "3000000"})
    )
    with service.running(worker=False):
        for size, status in ((2_999_999, 422), (3_000_001, 413), (9_000_000, 413)):
            connection = http.client.HTTPConnection("127.0.0.1", service.port)
            parts = (b"x" * min(1 << 16, size - at) for at in range(0, size, 1 << 16))
            with contextlib.suppress(BrokenPipeError, ConnectionResetError):
                connection.request(
                    "PUT",
                    f"/v1/blobs/{'0' * 64}",
                    body=parts,
                    encode_chunked=True,
                    headers={"Transfer-Encoding": "chunked"} | KNOWN,
                )
            assert connection.getresponse().status == status
            connection.close()
        assert list((tmp_path / "data" / "spool").glob("*/*")) == []


def test_an_upload_to_no_plant_is_refused(service):
    assert problem(service, "POST", "/v1/plants/nobody/episodes", episode_bytes())[:2] == (
        404,
        "not-found",
    )


@pytest.mark.parametrize(
    ("name", "status"),
    [
        ("..%2f..%2fetc", 404),  # several segments: no route
        ("a%00b", 422),
        ("UPPER", 422),
        ("a" * 64, 422),
        ("-x", 422),
    ],
)
def test_a_name_is_never_a_path(service, name, status):
    assert problem(service, "GET", f"/v1/plants/{name}")[0] == status


# -- artifacts


def test_versions_count_up_and_the_same_artifact_is_the_same_version(client, plant):
    first, second = identified(plant), identified(plant, 1.3)
    assert client.add_artifact(plant, first.manifest)["version"] == 2
    assert client.add_artifact(plant, second.manifest)["version"] == 3
    assert client.add_artifact(plant, first.manifest)["version"] == 2
    assert client.version(plant, 3)["digest"] == second.digest
    assert [a["version"] for a in client.artifacts(plant)] == [1, 2, 3]


def test_an_artifact_with_arrays_is_fetched_bit_for_bit(client, plant, tmp_path):
    made = pack(
        Residual(
            Plant.from_document(plant_document(plant)),
            LinearMap(("q", "v"), 0.01 * np.ones((2, 2))),
        ),
        {},
    )
    client.add_artifact(plant, made.manifest, made.arrays)
    folder = client.fetch(plant, made.digest, tmp_path / "model")
    assert (folder / "manifest.json").read_bytes() == made.manifest
    assert (folder / "arrays.safetensors").read_bytes() == made.arrays


def test_an_artifact_whose_arrays_were_never_sent_is_refused(service, plant):
    made = pack(
        Residual(
            Plant.from_document(plant_document(plant)),
            LinearMap(("q",), np.full((1, 2), uuid.uuid4().int % 1000 / 1e6)),
        ),
        {},
    )
    assert problem(service, "POST", f"/v1/plants/{plant}/artifacts", made.manifest)[:2] == (
        422,
        "bad-artifact",
    )


def test_an_artifact_that_lies_is_refused(service, plant):
    manifest = identified(plant).manifest
    assert problem(
        service, "POST", f"/v1/plants/{plant}/artifacts", manifest.replace(b'"k":1.2', b'"k":9.9')
    )[:2] == (422, "bad-artifact")


def test_an_artifact_of_another_plant_is_refused(service, plant):
    made = pack(Identified(CHAPTER, (1.2, 0.6, 0.8)), {})
    assert problem(service, "POST", f"/v1/plants/{plant}/artifacts", made.manifest)[:2] == (
        422,
        "bad-artifact",
    )


def test_a_blob_that_is_not_what_the_path_names_is_refused(service):
    assert problem(service, "PUT", f"/v1/blobs/{'0' * 64}", b"something")[:2] == (
        422,
        "digest-mismatch",
    )
    assert problem(service, "GET", f"/v1/blobs/{'0' * 64}")[0] == 404


def test_nothing_that_was_registered_can_be_deleted(service, client, plant, tmp_path):
    serving = client.serving(plant)
    status, code, found = problem(
        service, "DELETE", f"/v1/plants/{plant}/artifacts/{serving.artifact}"
    )
    assert (status, code, found["facts"]["serves"]) == (409, "kept", True)
    episode = client.upload_episode(plant, save(tmp_path, "e.mcap", episode_bytes()))
    assert problem(service, "DELETE", f"/v1/plants/{plant}/episodes/{episode['digest']}")[:2] == (
        409,
        "kept",
    )
    assert client.serving(plant) == serving


# -- serving


def test_the_answer_carries_a_tag_and_a_304_needs_no_body(service, plant):
    path = f"/v1/plants/{plant}/serving"
    status, headers, body = request(service, "GET", path)
    assert (status, headers["etag"]) == (200, '"1"')
    again = request(service, "GET", path, If_None_Match=headers["etag"])
    assert (again[0], again[2], again[1]["etag"]) == (304, b"", '"1"')
    assert json.loads(body)["generation"] == 1


def test_nobody_is_ever_told_of_an_older_pointer_than_the_last_acknowledged_move(
    service, client, plant
):
    """Eight readers poll while one promotes, and shortly after; each answer that begins after an
    acknowledgement has that generation at least."""
    acknowledged, moving, stop, wrong = [1], threading.Event(), threading.Event(), []

    def poll():
        reader = Client(service.url)
        while moving.wait() and not stop.is_set():
            floor = acknowledged[0]
            if reader.serving(plant).generation < floor:
                wrong.append(floor)
        reader.close()

    readers = [threading.Thread(target=poll) for _ in range(8)]
    for reader in readers:
        reader.start()
    for n in range(12):
        decision, generation = accepted(client, plant, 1.0 + n / 50), acknowledged[0]
        moving.set()
        acknowledged[0] = client.promote(plant, decision, generation).generation
        time.sleep(0.05)
        moving.clear()
    stop.set()
    moving.set()
    for reader in readers:
        reader.join()
    assert wrong == []
    assert acknowledged[0] == 13


def move(client, plant, k, gate=IMPROVING):
    """Promote by a real gate job on held-out data of the plant whose k is nearer each time."""
    decision = accepted(client, plant, k, gate)
    return client.promote(plant, decision, client.serving(plant).generation)


def accepted(client, plant, k, gate=IMPROVING):
    """A decision that accepts a candidate, whose k has to be nearer to the machine's 1.25 than that
    of what serves."""
    candidate = identified(plant, k)
    client.add_artifact(plant, candidate.manifest)
    gate = declare_following(client, plant, gate)
    if not list(client.episodes(plant, "validation")):
        with tempfile.TemporaryDirectory() as folder:
            client.upload_episode(
                plant, save(Path(folder), "v.mcap", episode_bytes(9, role=Role.VALIDATION))
            )
    job = client.wait(
        client.submit(
            plant, {"kind": "gate", "candidate": candidate.digest, "gate": gate["digest"]}
        )["id"]
    )
    assert job["result"]["accepted"]
    return job["result"]["decision"]


def test_a_long_poll_answers_at_the_move(service, client, plant):
    seen = []

    def watch():
        watcher = Client(service.url)
        for serving in watcher.watch(plant):
            seen.append(serving.generation)
            if len(seen) == 2:
                break
        watcher.close()

    watching = threading.Thread(target=watch)
    watching.start()
    moved = move(client, plant, 1.2)
    watching.join(timeout=20)
    assert seen == [1, moved.generation]


def test_a_long_poll_ends_with_304(service, plant):
    began = time.monotonic()
    status, _, _ = request(
        service, "GET", f"/v1/plants/{plant}/serving?wait_s=0.5", If_None_Match='"1"'
    )
    assert status == 304
    assert time.monotonic() - began >= 0.5


def test_a_stale_generation_is_refused(service, client, plant):
    moved = move(client, plant, 1.2)
    decision = moved.decision
    path = f"/v1/plants/{plant}/serving"
    body = json.dumps({"decision": decision, "expected_generation": moved.generation})
    assert problem(service, "POST", f"{path}/promote", body, Content_Type="application/json")[
        :2
    ] == (409, "pointer-moved")
    body = json.dumps({"expected_generation": 1})
    assert problem(service, "POST", f"{path}/rollback", body, Content_Type="application/json")[
        :2
    ] == (409, "pointer-moved")


def test_there_is_nothing_before_the_first(service, plant):
    body = json.dumps({"expected_generation": 1})
    path = f"/v1/plants/{plant}/serving/rollback"
    assert problem(service, "POST", path, body, Content_Type="application/json")[:2] == (
        409,
        "nothing-to-roll-back-to",
    )


def test_a_rollback_goes_back_and_says_what_was_tested(client, plant):
    moved = move(client, plant, 1.2)
    back = client.roll_back(plant, moved.generation)
    assert (back.version, back.generation, back.move) == (1, 3, "rolled_back")
    last = list(client.audit(plant))[-1]
    assert last["kind"] == "pointer:moved"
    tested = last["facts"]["switchback"]
    held = ("loads", "digests_hold", "answers_probe", "fits_plant")
    assert {name: tested[name] for name in held} == dict.fromkeys(held, True)
    assert (tested["artifact"], tested["from_generation"]) == (back.artifact, moved.generation)
    assert tested["fallback"] is None  # nothing is older than the registered model
    assert set(tested["libraries"]) == {"python", "numpy", "numba", "safetensors"}
    assert len(tested["loaded_by"]["sha256"]) == 64
    assert tested["made_by"] is None  # it was declared, not fitted
    assert tested["session"] == {
        "form": "nominal",
        "remembers": [],
        "filter": False,
        "step_s": 0.05,
        "states": ["position of joint", "velocity of joint"],
        "on_switch": (
            "nothing to carry over: the next state follows from the last observed one alone"
        ),
    }


def test_a_rollback_may_name_an_older_generation_and_no_other_one(client, plant):
    move(client, plant, 1.1)
    third = move(client, plant, 1.2)
    with pytest.raises(Problem) as refused:
        client.roll_back(plant, third.generation, to_generation=third.generation)
    assert (refused.value.status, refused.value.code) == (409, "not-to-roll-back-to")
    assert refused.value.hint == "Choose one of 2, 1."
    back = client.roll_back(plant, third.generation, to_generation=1)
    assert (back.version, back.generation, back.move) == (1, 4, "rolled_back")
    with pytest.raises(Problem) as nothing:
        client.roll_back(plant, back.generation)
    assert nothing.value.code == "nothing-to-roll-back-to"


def test_what_serves_in_the_future_is_not_known(client, plant):
    with pytest.raises(Problem) as refused:
        client.served_at(plant, "2999-01-01T00:00:00Z")
    assert (refused.value.status, refused.value.code) == (422, "in-the-future")
    assert "is not known" in refused.value.detail


def test_a_repeated_rollback_under_one_key_moves_once(service, client, plant):
    moved = move(client, plant, 1.2)
    body, key = json.dumps({"expected_generation": moved.generation}), uuid.uuid4().hex
    answers = [
        request(
            service,
            "POST",
            f"/v1/plants/{plant}/serving/rollback",
            body,
            Content_Type="application/json",
            Idempotency_Key=key,
        )
        for _ in range(3)
    ]
    assert [a[0] for a in answers] == [200, 200, 200]
    assert len({a[2] for a in answers}) == 1
    assert client.serving(plant).generation == moved.generation + 1


def test_history_joins_a_recording_to_what_was_serving(client, plant, tmp_path):
    moved = move(client, plant, 1.2)
    assert client.served_at(plant, moved.since).generation == moved.generation
    assert client.served_at(plant, "2020-01-01T00:00:00Z") is None
    now = time.time_ns()
    layout = Plant.from_document(plant_document(plant)).layout
    data = mcap_bytes(layout, np.zeros((20, 2)), np.zeros((20, 1)), start_ns=now)
    found = client.upload_episode(plant, save(tmp_path, "now.mcap", data))
    assert [s["generation"] for s in client.episode(plant, found["digest"])["served"]] == [
        moved.generation
    ]


def test_nagles_algorithm_is_off_on_accepted_connections():
    """Small answers on a kept connection must not wait for the other side's delayed
    acknowledgement, 40 ms each."""
    with listen("127.0.0.1", 0) as listening, socket.create_connection(listening.getsockname()):
        accepted, _ = listening.accept()
        assert accepted.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)
        accepted.close()


# -- jobs


def test_a_fit_never_reads_held_out_episodes(service, client, plant, tmp_path):
    held_out = client.upload_episode(
        plant, save(tmp_path, "v.mcap", episode_bytes(4, role=Role.VALIDATION))
    )["digest"]
    test = client.upload_episode(plant, save(tmp_path, "t.mcap", episode_bytes(5, role=Role.TEST)))[
        "digest"
    ]
    path = f"/v1/plants/{plant}/jobs"
    for digest in (held_out, test):
        body = json.dumps({"kind": "fit", "method": "identify", "episodes": [digest]})
        assert problem(service, "POST", path, body, Content_Type="application/json")[:2] == (
            403,
            "role-refused",
        )
    client.upload_episode(plant, save(tmp_path, "a.mcap", episode_bytes(6)))
    job = client.wait(client.submit(plant, {"kind": "fit", "method": "identify"})["id"])
    assert set(job["reads"]) == {e["digest"] for e in client.episodes(plant, "adaptation")}


def test_a_gate_never_reads_adaptation_or_test_episodes(service, client, plant, tmp_path):
    candidate = identified(plant)
    client.add_artifact(plant, candidate.manifest)
    gate = client.declare_gate(plant)
    for seed, role in ((1, Role.ADAPTATION), (2, Role.TEST)):
        digest = client.upload_episode(
            plant, save(tmp_path, f"{seed}.mcap", episode_bytes(seed, role=role))
        )["digest"]
        body = json.dumps(
            {
                "kind": "gate",
                "candidate": candidate.digest,
                "gate": gate["digest"],
                "episodes": [digest],
            }
        )
        assert problem(
            service, "POST", f"/v1/plants/{plant}/jobs", body, Content_Type="application/json"
        )[:2] == (403, "role-refused")


def test_a_job_without_data_is_refused(service, plant):
    body = json.dumps({"kind": "fit", "method": "identify"})
    assert problem(
        service, "POST", f"/v1/plants/{plant}/jobs", body, Content_Type="application/json"
    )[:2] == (422, "not-identifiable")


def test_a_job_that_fails_says_why(client, plant, tmp_path):
    layout = Plant.from_document(plant_document(plant)).layout
    client.upload_episode(
        plant,
        save(tmp_path, "still.mcap", mcap_bytes(layout, np.zeros((50, 2)), np.zeros((50, 1)))),
    )
    with pytest.raises(Problem) as refused:
        client.wait(client.submit(plant, {"kind": "fit", "method": "identify"})["id"])
    assert refused.value.code == "not-identifiable"
    assert "rank 0" in refused.value.detail


def test_an_artifact_tells_where_it_comes_from(client, plant, tmp_path):
    digest = client.upload_episode(plant, save(tmp_path, "a.mcap", episode_bytes(6, stage="MIL")))[
        "digest"
    ]
    nominal = client.serving(plant).artifact
    job = client.wait(client.submit(plant, {"kind": "fit", "method": "residual"})["id"])
    folder = client.fetch(plant, job["result"]["artifact"], tmp_path / "m")
    provenance = json.loads((folder / "manifest.json").read_text())["provenance"]
    assert provenance["episodes"] == [
        {"sha256": digest, "role": "adaptation", "conditions": {"stage": "MIL"}}
    ]
    assert provenance["parent"] == nominal
    assert set(provenance) == {
        "origin",
        "episodes",
        "coverage",
        "configuration",
        "code",
        "seed",
        "parent",
        "report",
    }


# -- whoever asks


def test_the_actor_stands_on_every_change(service, tmp_path):
    name = f"p{uuid.uuid4().hex[:8]}"
    with contextlib.closing(Client(service.url, actor="ada@bench")) as ada:
        ada.register_plant(plant_document(name))
        ada.promote(name, accepted(ada, name, 1.2), 1)
        ada.roll_back(name, 2)
        ada.declare_channel(name, "field", [])
        ada.upload_episode(name, save(tmp_path, "e.mcap", episode_bytes(1)))
        ada.wait(ada.submit(name, {"kind": "fit", "method": "identify"})["id"])
        made = [(e["kind"], e["actor"]) for e in ada.audit(name)]
    assert {actor for _, actor in made} == {"admin for ada@bench"}
    assert {kind for kind, _ in made} == {
        "plant:registered",
        "episode:ingested",
        "artifact:added",
        "gate:declared",
        "job:submitted",
        "job:finished",
        "decision:made",
        "pointer:moved",
        "channel:declared",
    }


def test_a_request_id_is_kept_if_it_is_plain(service):
    assert request(service, "GET", "/healthz", X_Request_Id="abc-1")[1]["x-request-id"] == "abc-1"
    assert request(service, "GET", "/healthz", X_Request_Id="a b<c>")[1]["x-request-id"] != "a b<c>"


def test_health_readiness_and_metrics_answer(service, plant):
    assert json.loads(request(service, "GET", "/healthz")[2])["status"] == "ok"
    assert json.loads(request(service, "GET", "/readyz")[2])["ready"] is True
    assert (
        b'trueup_http_requests_total{method="GET",route="/readyz",status="200"}'
        in request(service, "GET", "/metrics")[2]
    )


def test_an_unknown_route_and_method_are_problems(service, plant):
    assert problem(service, "GET", "/v1/nothing")[0] == 404
    assert problem(service, "PATCH", f"/v1/plants/{plant}")[0] == 405


def test_a_wrong_plant_is_refused_at_its_field(service):
    document = plant_document("x") | {"colour": "red"}
    status, code, found = problem(
        service, "POST", "/v1/plants", json.dumps(document), Content_Type="application/json"
    )
    assert (status, code, found["facts"]["field"]) == (422, "bad-plant", "colour")


def test_a_damaged_download_is_thrown_away(client, plant, tmp_path, monkeypatch):
    serving = client.serving(plant)
    monkeypatch.setattr(client._connection, "parts", lambda path: iter([b"damaged"]))
    with pytest.raises(DigestMismatch):
        client.fetch(plant, serving.artifact, tmp_path / "m")
    assert list((tmp_path / "m").iterdir()) == []
