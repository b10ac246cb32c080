"""What others send is never held in the server's memory whole: arrays are read by a child, bodies
have a limit all together."""

import asyncio
import hashlib
import json
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import save as packed_arrays

from tests.http.test_http import problem, request
from tests.support.made import identified, plant_document
from tests.support.service import Service
from trueup.canonical import canonical_bytes
from trueup_client import Client
from trueup_service.authentication import Principal
from trueup_service.errors import MemoryFull, TooLargeUpload
from trueup_service.http.body_limit import FORM_BYTES, BodyLimit

LARGE = 124 << 20  # nearly what an artifact may have
ROOM = 4 << 20


def peak_bytes(pid: int) -> int:
    """The most memory that a process has ever held."""
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    return next(int(line.split()[1]) << 10 for line in lines if line.startswith("VmHWM"))


@pytest.fixture
def server(storage):
    """A server alone, with its process."""
    found = Service(storage, bodies_limit_bytes=ROOM)
    child = found.start_server()
    yield found, child.pid
    found.stop()


def manifest_of(arrays: bytes) -> bytes:
    """A residual's manifest that names arrays which are none of a residual."""
    document = json.loads(identified("p").manifest)
    named = {"sha256": hashlib.sha256(arrays).hexdigest(), "bytes": len(arrays)}
    return canonical_bytes({**document, "kind": "residual", "arrays": named})


def test_large_arrays_are_looked_at_by_another_process(server):
    service, pid = server
    arrays = packed_arrays({"w": np.zeros(LARGE // 8)})
    digest, manifest = hashlib.sha256(arrays).hexdigest(), manifest_of(arrays)
    with closing(Client(service.url)) as client:
        client.register_plant(plant_document("p"))
    # loads what that needs
    request(
        service,
        "POST",
        "/v1/plants/p/artifacts",
        manifest_of(b"none"),
        Content_Type="application/json",
    )
    before = peak_bytes(pid)
    assert request(service, "PUT", f"/v1/blobs/{digest}", arrays)[0] == 201
    with ThreadPoolExecutor(4) as at_once:
        answers = list(
            at_once.map(
                lambda _: problem(service, "POST", "/v1/plants/p/artifacts", manifest), range(4)
            )
        )
    assert {(status, code) for status, code, _ in answers} <= {
        (422, "bad-artifact"),
        (422, "inspection-limit"),
    }
    assert peak_bytes(pid) - before < LARGE // 2


def test_arrays_over_the_limit_are_413_before_they_are_sent_and_where_they_were_there(storage):
    arrays = packed_arrays({"w": np.zeros(1000)})
    digest = hashlib.sha256(arrays).hexdigest()
    wide = Service(storage)
    with wide.running(worker=False), closing(Client(wide.url)) as client:
        client.register_plant(plant_document("p"))
        assert request(wide, "PUT", f"/v1/blobs/{digest}", arrays)[0] == 201
    narrow = Service(storage, arrays_limit_bytes=4000)
    with narrow.running(worker=False):
        for method, path, body in (
            ("PUT", f"/v1/blobs/{digest}", arrays),
            ("POST", "/v1/plants/p/artifacts", manifest_of(arrays)),
        ):
            status, code, document = problem(narrow, method, path, body)
            assert (status, code, document["facts"]["limit_bytes"]) == (
                413,
                "upload-too-large",
                4000,
            )
            assert "TRUEUP_ARRAYS_LIMIT_BYTES" in document["hint"]


def asked(size, token="t", path="/v1/plants"):
    """What a server receives of a request: its body at once, with a token or without."""

    async def receive():
        return {"type": "http.request", "body": bytes(size), "more_body": False}

    principal = (
        {} if token is None else {"principal": Principal(token, token, frozenset(), None, None)}
    )
    return {"type": "http", "path": path, **principal}, receive


def test_one_token_leaves_room_for_others_and_who_has_none_takes_no_room():
    go_on = asyncio.Event()

    async def app(scope, receive, send):
        await receive()
        if scope["path"] == "/held":
            await go_on.wait()

    async def all_of_them():
        limiting = BodyLimit(app, 4 * ROOM)
        greedy = [
            asyncio.create_task(limiting(*asked(4 << 20, "greedy", "/held"), None))
            for _ in range(2)
        ]
        await asyncio.sleep(0)
        with pytest.raises(MemoryFull, match="with this token"):
            await limiting(*asked(1 << 20, "greedy"), None)
        await limiting(*asked(4 << 20, "other"), None)
        go_on.set()
        await asyncio.gather(*greedy)
        await limiting(*asked(1 << 20, "greedy"), None)
        full = BodyLimit(app, ROOM)
        full._room = 0
        await full(*asked(FORM_BYTES, None, "/v1/session"), None)
        with pytest.raises(TooLargeUpload):
            await full(*asked(FORM_BYTES + 1, None, "/v1/session"), None)

    asyncio.run(all_of_them())


def test_bodies_have_a_limit_all_together_and_room_comes_back():
    reading, go_on, refused = asyncio.Event(), asyncio.Event(), []

    async def app(scope, receive, send):
        try:
            await receive()
        except MemoryFull as error:
            refused.append(error.code)
            return
        reading.set()
        await go_on.wait()

    async def both():
        limiting = BodyLimit(app, ROOM)
        first = asyncio.create_task(limiting(*asked(3 << 20), None))
        await reading.wait()
        await limiting(*asked(2 << 20), None)
        assert refused == ["memory-full"]
        await asyncio.gather(limiting(*asked(1 << 20), None), _soon(go_on), first)
        await limiting(*asked(4 << 20), None)
        assert refused == ["memory-full"]

    async def _soon(event):
        event.set()

    asyncio.run(both())


def test_who_finds_no_room_is_told_when_to_come_again(server):
    service, _ = server
    body = json.dumps({"x": "y" * (3 << 20)}).encode()
    answers = set()
    with ThreadPoolExecutor(8) as at_once:
        while 503 not in answers:
            for status, headers, content in at_once.map(
                lambda _: request(service, "POST", "/v1/plants", body), range(8)
            ):
                assert status in {422, 503}
                assert status != 503 or (headers["Retry-After"], json.loads(content)["code"]) == (
                    "1",
                    "memory-full",
                )
                answers.add(status)
    assert problem(service, "POST", "/v1/plants", body, Content_Type="application/json")[0] == 422


def test_refused_bodies_do_not_stay_in_memory(server):
    service, pid = server
    body = b'{"x": "' + b"y" * (3 << 20)
    for _ in range(3):
        assert (
            problem(service, "POST", "/v1/plants", body, Content_Type="application/json")[0] == 422
        )
    before = peak_bytes(pid)
    for _ in range(60):
        problem(service, "POST", "/v1/plants", body, Content_Type="application/json")
    assert peak_bytes(pid) - before < 60 * len(body) // 3


@pytest.mark.parametrize("opening", ["[", '{"a":'])
def test_json_that_is_nested_without_end_is_refused(server, opening):
    service, _ = server
    with closing(Client(service.url)) as client:
        client.register_plant(plant_document("p"))
    body = (opening * 200_000).encode()
    for path in (
        "/v1/plants",
        "/v1/plants/p/gates",
        "/v1/plants/p/jobs",
        "/v1/plants/p/evidence",
        "/v1/plants/p/artifacts",
        "/v1/tokens",
    ):
        found = problem(service, "POST", path, body, Content_Type="application/json")[:2]
        artifact = path.endswith("artifacts")  # whose body is kept as it was sent
        assert found == ((422, "bad-artifact") if artifact else (400, "bad-request")), path
