"""Nobody shuts others out by holding connections, nor ends what takes its time for a reason."""

import contextlib
import hashlib
import json
import socket
import time

import pytest

from tests.http.test_http import request
from tests.support.made import plant_document
from tests.support.service import ADMIN, Service
from tests.support.storage import Storage, embedded
from trueup_client import Client

FILES = 256


def few(tmp_path, **settings):
    """A service that may open few files, with short limits."""
    storage = embedded(tmp_path / "data")
    settings = {
        "header_limit_s": 2,
        "keep_alive_s": 2,
        "silence_limit_s": 2,
        "checkpoint_interval_s": 0.2,
        **settings,
    }
    return Service(
        Storage("few", storage.environment | {"TRUEUP_TEST_FILES": str(FILES)}), **settings
    )


@pytest.fixture
def service(tmp_path):
    found = few(tmp_path)
    try:
        found.start_server(module="tests.support.file_limit")
        yield found
    finally:
        found.stop()


@contextlib.contextmanager
def held(service, count, sent=b""):
    """So many connections that have sent this and wait."""
    with contextlib.ExitStack() as stack:
        found = []
        for _ in range(count):
            raw = stack.enter_context(socket.socket())
            raw.settimeout(10)
            raw.connect(("127.0.0.1", service.port))
            with contextlib.suppress(OSError):
                raw.sendall(sent)
            found.append(raw)
        yield found


def answer(raw):
    """All that a connection says until it closes."""
    said = b""
    with contextlib.suppress(ConnectionResetError):
        while part := raw.recv(1 << 16):
            said += part
    return said


HALF = b"GET /healthz HTTP/1.1\r\nHost: 127.0.0.1\r\nX-Half: "


@pytest.mark.parametrize(
    "sent", [b"", HALF, b"\r\n\r\n"], ids=["nothing", "half a head", "empty lines"]
)
def test_connections_that_never_ask_shut_nobody_out_and_the_checkpoint_is_written(
    service, tmp_path, sent
):
    client, checkpoint = Client(service.url), tmp_path / "data" / "checkpoint"
    with held(service, 2 * FILES, sent):
        for number in range(3):
            assert request(service, "GET", "/healthz")[0] == 200
            client.register_plant(plant_document(f"p{number}"))
            size = client.checkpoint().splitlines()[1]
            until(
                lambda size=size: (
                    checkpoint.exists() and checkpoint.read_text().splitlines()[1] == size
                )
            )
    client.close()


def until(holds):
    deadline = time.monotonic() + 10
    while not holds():
        assert time.monotonic() < deadline
        time.sleep(0.05)


def test_a_head_that_does_not_come_whole_is_answered_408_and_a_connection_without_a_request_ends(
    service,
):
    with (
        held(service, 1, HALF) as (half,),
        held(service, 1) as (silent,),
        held(service, 1, b"GET /healthz HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n") as (asked,),
    ):
        said = answer(half)
        assert said.startswith(b"HTTP/1.1 408 ")
        assert json.loads(said.partition(b"\r\n\r\n")[2])["code"] == "request-timeout"
        assert answer(silent) == b""
        assert answer(asked).startswith(b"HTTP/1.1 200 ")


def test_a_head_that_drips_does_not_go_on_for_ever(service):
    with held(service, 1, HALF) as (raw,):
        said = dripped(raw, b"x", 0.2)
    assert said == b"" or said.startswith(b"HTTP/1.1 408 ")


def test_a_head_without_an_end_is_refused_before_it_fills_the_memory(service):
    with held(service, 1, HALF + b"x" * (1 << 19)) as (raw,):
        said = answer(raw)
        assert not said or said.startswith(b"HTTP/1.1 431 ")
    with held(service, 1, HALF + b"x" * (1 << 16)) as (raw,):
        said = answer(raw)
        assert said.startswith(b"HTTP/1.1 431 ")
        assert json.loads(said.partition(b"\r\n\r\n")[2])["code"] == "head-too-large"


def put(token, length, path="/v1/blobs/" + "0" * 64):
    return (
        f"PUT {path} HTTP/1.1\r\nHost: 127.0.0.1\r\nAuthorization: Bearer "
        f"{token}\r\nContent-Length: {length}\r\n\r\n"
    ).encode()


def dripped(raw, part, pause_s, parts=200):
    """What is answered where a part is sent again and again until the connection is closed. Fails
    if so many parts were taken: the service's limits are of 2 s."""
    raw.settimeout(pause_s)
    said = b""
    for _ in range(parts):
        try:
            raw.sendall(part)
            more = raw.recv(1 << 16)
            said += more
            if not more:
                return said
        except TimeoutError:
            continue
        except OSError:
            return said
    pytest.fail(f"the connection took {parts} parts and was still open")


@pytest.mark.parametrize("token", [ADMIN, "nobodys"])
def test_a_body_that_drips_ends(service, token):
    with held(service, 1, put(token, 1 << 20)) as (raw,):
        said = dripped(raw, b"x", 0.3)
    assert said.startswith(b"HTTP/1.1 408 " if token == ADMIN else b"HTTP/1.1 401 ")


def test_a_body_that_comes_slowly_but_steadily_is_taken(service):
    with held(service, 1, put(ADMIN, 20 * 60)) as (raw,):
        for _ in range(20):
            raw.sendall(b"x" * 60)
            time.sleep(0.25)
        # all of it came, and is not what the digest names
        assert raw.recv(1 << 16).startswith(b"HTTP/1.1 422 ")


def test_a_long_poll_is_no_silence(service):
    """It is held for three times the limit of a silence, and answered."""
    client = Client(service.url)
    client.register_plant(plant_document("polled"))
    tag = request(service, "GET", "/v1/plants/polled/serving")[1]["etag"]
    began = time.monotonic()
    assert (
        request(service, "GET", "/v1/plants/polled/serving?wait_s=6", If_None_Match=tag)[0] == 304
    )
    assert time.monotonic() - began > 5
    client.close()


def test_an_answer_that_nobody_takes_ends_and_one_that_is_taken_slowly_does_not(service):
    data = bytes(24 << 20)
    digest = hashlib.sha256(data).hexdigest()
    assert request(service, "PUT", f"/v1/blobs/{digest}", data)[0] == 201
    get = (
        f"GET /v1/blobs/{digest} HTTP/1.1\r\nHost: 127.0.0.1\r\nAuthorization: Bearer "
        f"{ADMIN}\r\nConnection: close\r\n\r\n"
    ).encode()
    with held(service, 2, get) as (untaken, slow):
        taken = 0
        while part := slow.recv(1 << 20):
            taken += len(part)
            time.sleep(0.15)
        assert taken > len(data)
        assert len(answer(untaken)) < len(data)


def test_where_every_connection_has_a_request_a_new_one_is_answered_503(tmp_path):
    service = few(tmp_path, connections=3)
    try:
        service.start_server(module="tests.support.file_limit")
        client = Client(service.url)
        client.register_plant(plant_document("polled"))
        client.close()
        line = "GET /v1/plants/polled/serving?wait_s=4 HTTP/1.1"
        ask = (
            f"{line}\r\nHost: 127.0.0.1\r\nAuthorization: Bearer {ADMIN}\r\nIf-None-Match: "
            '"1"\r\n\r\n'
        )
        with held(service, 3, ask.encode()) as waiting:
            time.sleep(1)
            status, headers, body = request(service, "GET", "/healthz")
            assert (status, headers["content-type"], json.loads(body)["code"]) == (
                503,
                "application/problem+json",
                "busy",
            )
            assert [raw.recv(12) for raw in waiting] == [b"HTTP/1.1 304"] * 3
            assert request(service, "GET", "/healthz")[0] == 200
    finally:
        service.stop()
