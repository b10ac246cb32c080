"""What nobody should send, and what happens at the same moment."""

import json
import threading
import uuid
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from urllib.parse import unquote

import pytest

from tests.http.test_http import accepted, move, problem, request
from tests.support.made import episode_bytes, plant_document, save
from trueup_client import Client, Problem

JSON = {"Content_Type": "application/json"}


@pytest.fixture
def plant(client):
    name = f"p{uuid.uuid4().hex[:12]}"
    client.register_plant(plant_document(name))
    return name


def eight(act):
    with ThreadPoolExecutor(8) as pool:
        return list(pool.map(lambda _: act(), range(8)))


def test_a_registration_repeated_at_the_same_moment_has_one_answer(service):
    body, key = json.dumps(plant_document(f"p{uuid.uuid4().hex[:12]}")), uuid.uuid4().hex
    answers = eight(
        lambda: request(service, "POST", "/v1/plants", body, Idempotency_Key=key, **JSON)
    )
    assert {a[0] for a in answers} == {201}
    assert len({a[2] for a in answers}) == 1


def test_a_registration_sent_by_many_at_once_is_made_once(service):
    body = json.dumps(plant_document(f"p{uuid.uuid4().hex[:12]}"))
    answers = eight(lambda: request(service, "POST", "/v1/plants", body, **JSON))
    assert sorted(a[0] for a in answers) == [200] * 7 + [201]


def test_a_promotion_and_a_rollback_repeated_at_the_same_moment_move_once(service, client, plant):
    decision, generation = accepted(client, plant, 1.2), client.serving(plant).generation
    promotion = {"decision": decision, "expected_generation": generation}
    rollback = {"expected_generation": generation + 1}
    for move_by, body in (("promote", promotion), ("rollback", rollback)):
        path, sent, key = (
            f"/v1/plants/{plant}/serving/{move_by}",
            json.dumps(body),
            uuid.uuid4().hex,
        )
        answers = eight(
            lambda path=path, sent=sent, key=key: request(
                service, "POST", path, sent, Idempotency_Key=key, **JSON
            )
        )
        assert {a[0] for a in answers} == {200}
        assert len({a[2] for a in answers}) == 1
    assert client.serving(plant).generation == generation + 2


@pytest.mark.parametrize("off", [-1, 1])
def test_a_keyed_rollback_from_another_generation_is_refused(service, client, plant, off):
    moved = move(client, plant, 1.2)
    body = json.dumps({"expected_generation": moved.generation + off})
    path = f"/v1/plants/{plant}/serving/rollback"
    assert problem(service, "POST", path, body, Idempotency_Key=uuid.uuid4().hex, **JSON)[:2] == (
        409,
        "pointer-moved",
    )
    assert client.serving(plant) == moved


def test_a_job_cancelled_by_many_at_once_is_cancelled_once(service, client, plant, tmp_path):
    client.upload_episode(plant, save(tmp_path, "a.mcap", episode_bytes()))
    job = client.submit(plant, {"kind": "fit", "method": "identify"})["id"]
    answers = eight(lambda: request(service, "POST", f"/v1/jobs/{job}/cancel"))
    try:
        client.wait(job)
        cancelled = 0  # the worker was faster
    except Problem as ended:
        cancelled = int(ended.code == "cancelled")
    assert {a[0] for a in answers} <= {200, 409}
    assert 200 in {a[0] for a in answers} or not cancelled
    kinds = [e["kind"] for e in client.audit(plant) if e["subject"] == job]
    assert kinds.count("job:cancelled") == cancelled


HUGE = "9" * 400
BODIES = {
    "an integer that no float holds, in a plant": (
        "/v1/plants",
        json.dumps(plant_document("x")).replace("0.05", HUGE),
    ),
    "an integer that no float holds, in a gate": (
        "/v1/plants/PLANT/gates",
        '{"schema":"trueup.gate/1","rules":[{"rule":"rollout_improves","ratio":'
        + HUGE
        + '}],"scoring":{"horizon_s":1,"windows":"first"}}',
    ),
    "a horizon that no float holds": (
        "/v1/plants/PLANT/gates",
        '{"schema":"trueup.gate/1","rules":[{"rule":"rollout_improves"}],"scoring":{"horizon_s":'
        + HUGE
        + ',"windows":"first"}}',
    ),
    "half a character, in a plant": ("/v1/plants", json.dumps(plant_document("x") | {"\ud800": 1})),
    "half a character, in a gate": ("/v1/plants/PLANT/gates", '{"\\ud800":1}'),
    "half a character, in a unit": (
        "/v1/plants",
        json.dumps(plant_document("x")).replace("m/s^2", "\\ud800"),
    ),
    "not a number": ("/v1/plants", json.dumps(plant_document("x")).replace("0.05", "NaN")),
    "deep nesting": ("/v1/plants", "[" * 100_000),
    "a manifest without arrays": ("/v1/plants/PLANT/artifacts", '{"schema":"trueup.artifact/1"}'),
    "a manifest with empty arrays": (
        "/v1/plants/PLANT/artifacts",
        '{"arrays":{},"schema":"trueup.artifact/1"}',
    ),
    "a manifest with a plant of another type": (
        "/v1/plants/PLANT/artifacts",
        '{"arrays":null,"plant":[],"schema":"trueup.artifact/1"}',
    ),
    "five megabytes of JSON": ("/v1/plants", '{"name":"' + "x" * (5 << 20) + '"}'),
    "five megabytes of manifest": (
        "/v1/plants/PLANT/artifacts",
        '{"name":"' + "x" * (5 << 20) + '"}',
    ),
}


@pytest.mark.parametrize("name", BODIES)
@pytest.mark.parametrize("with_key", [False, True])
def test_a_bad_body_is_refused_as_the_callers_fault(service, plant, name, with_key):
    path, body = BODIES[name]
    headers = JSON | ({"Idempotency_Key": uuid.uuid4().hex} if with_key else {})
    status, code, _ = problem(
        service, "POST", path.replace("PLANT", plant), body.encode(), **headers
    )
    assert 400 <= status < 500, code


@pytest.mark.parametrize(
    "path",
    [
        "/v1/plants/%00/serving",
        "/v1/audit?plant=%00",
        "/v1/plants?after=%00",
        "/v1/plants/PLANT/decisions?before=%00",
        "/v1/plants/PLANT/gates?after=%00",
    ],
)
def test_a_zero_byte_is_never_the_services_fault(service, plant, path):
    assert request(service, "GET", path.replace("PLANT", plant))[0] < 500


@pytest.mark.parametrize("tag", ['W/"1"', "*", '"0", "1"', '"0",W/"1"'])
def test_a_tag_is_matched_in_every_form_that_http_knows(service, plant, tag):
    assert request(service, "GET", f"/v1/plants/{plant}/serving", If_None_Match=tag)[0] == 304


@pytest.mark.parametrize("wait", ["-1", "nan", "soon"])
def test_a_wait_that_is_no_time_is_refused(service, plant, wait):
    assert problem(service, "GET", f"/v1/plants/{plant}/serving?wait_s={wait}")[:2] == (
        400,
        "bad-request",
    )


@pytest.mark.parametrize("name", ["a b", "a\nb", "ä", "a?b", "../x", "%2e%2e", "a#b"])
def test_the_client_sends_any_name_as_one_segment(service, name):
    asked = []

    class Nowhere(BaseHTTPRequestHandler):
        def do_GET(self):
            asked.append(self.path)
            self.send_error(404)

        def log_message(self, *_):
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), Nowhere) as server:
        threading.Thread(target=server.serve_forever).start()
        for url in (f"http://127.0.0.1:{server.server_port}", service.url):
            with closing(Client(url)) as client, pytest.raises(Problem) as refused:
                client.serving(name)
            assert refused.value.status == 404
        server.shutdown()
    assert [[unquote(part) for part in path.split("/")] for path in asked] == [
        ["", "v1", "plants", name, "serving"]
    ]
