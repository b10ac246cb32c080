"""What is too large, and what is no longer what it was: bodies over the limit, damaged bytes,
listings of long documents."""

import hashlib
import http.client
import json
import re
import uuid
from contextlib import closing

import numpy as np
import pytest

from tests.http.test_http import KNOWN, problem, request
from tests.support.made import episode_bytes, plant_document, save
from tests.support.service import command
from trueup.gate.evidence import SCHEMA
from trueup_client import Client
from trueup_service.registry.blobs import STREAM_BYTES

JSON = {"Content_Type": "application/json"}


@pytest.fixture
def plant(client):
    name = f"p{uuid.uuid4().hex[:12]}"
    client.register_plant(plant_document(name))
    return name


def test_json_over_the_limit_is_413_on_every_route_that_reads_a_body(service, plant):
    body = json.dumps({"name": "x" * (5 << 20)})
    described = json.loads(request(service, "GET", "/openapi.json")[2])["paths"]
    routes = [
        (
            method.upper(),
            re.sub(r"\{(\w+)\}", lambda m: plant if m[1] == "plant" else "0" * 64, path),
        )
        for path, operations in described.items()
        for method, operation in operations.items()
        if "application/json" in operation.get("requestBody", {}).get("content", {})
    ]
    assert len(routes) > 15
    for method, path in routes:
        status, code, document = problem(service, method, path, body, **JSON)
        limit = (16 << 10) if path == "/v1/session" else (4 << 20)  # one needs no token
        assert (status, code, document["facts"]["limit_bytes"]) == (413, "upload-too-large", limit)


# -- damaged bytes


def damage(service, digest, data):
    """Put other bytes in the place of a digest's, past the service."""
    if service.storage.name == "embedded":
        parts = service.storage.build()
        path = parts.settings.data_dir / "blobs" / digest[:2] / digest[2:]
        path.chmod(0o600)
        path.write_bytes(data)
        parts.close()
    else:
        import obstore

        parts = service.storage.build()
        obstore.put(parts.blobs._store, digest, data)
        parts.close()


def flipped(data, at):
    return data[:at] + bytes([data[at] ^ 1]) + data[at + 1 :]


DAMAGES = {
    "its first byte": lambda data: flipped(data, 0),
    "its last byte": lambda data: flipped(data, len(data) - 1),
    "cut": lambda data: data[:-1],
    "longer": lambda data: data + b"x",
    "longer, and its first byte": lambda data: flipped(data, 0) + b"x" * STREAM_BYTES,
    "empty": lambda _: b"",
}


def got(service, path):
    """Status, entity tag and bytes of an answer, None for one that broke off."""
    with closing(http.client.HTTPConnection("127.0.0.1", service.port, timeout=60)) as connection:
        connection.request("GET", path, headers=KNOWN)
        with connection.getresponse() as answer:
            try:
                return answer.status, answer.headers["etag"], answer.read()
            except (http.client.IncompleteRead, ConnectionError):
                return None


@pytest.mark.parametrize("size", [1000, STREAM_BYTES, 3 * STREAM_BYTES, 3 * STREAM_BYTES + 7])
@pytest.mark.parametrize("how", DAMAGES)
def test_damaged_bytes_are_never_a_whole_answer(service, size, how):
    data = np.random.default_rng(size).bytes(size - 16) + uuid.uuid4().bytes
    digest = hashlib.sha256(data).hexdigest()
    path = f"/v1/blobs/{digest}"
    assert request(service, "PUT", path, data)[0] == 201
    assert got(service, path) == (200, f'"{digest}"', data)
    damage(service, digest, DAMAGES[how](data))
    answer = got(service, path)
    assert answer is None or answer[0] == 500
    if len(DAMAGES[how](data)) <= STREAM_BYTES:
        assert problem(service, "GET", path)[:2] == (500, "blob-damaged")
    damage(service, digest, data)
    assert got(service, path) == (200, f'"{digest}"', data)


@pytest.mark.parametrize("how", DAMAGES)
def test_a_damaged_episode_is_never_a_whole_answer(service, client, plant, tmp_path, how):
    data = episode_bytes(uuid.uuid4().int % 1000)
    digest = client.upload_episode(plant, save(tmp_path, "e.mcap", data))["digest"]
    damage(service, digest, DAMAGES[how](data))
    path = f"/v1/plants/{plant}/episodes/{digest}/content"
    answer = got(service, path)
    assert answer is None or answer[0] == 500


def test_a_damaged_manifest_is_not_sent(tmp_path):
    import sqlite3

    from tests.support.service import Service
    from tests.support.storage import embedded

    service = Service(embedded(tmp_path / "data"))
    with service.running(worker=False):
        client = Client(service.url)
        client.register_plant(plant_document("p"))
        digest = client.serving("p").artifact
        with sqlite3.connect(tmp_path / "data" / "trueup.sqlite") as kept:
            kept.execute("DROP TRIGGER IF EXISTS artifacts_kept")
            kept.execute("UPDATE artifacts SET manifest = replace(manifest, '0.4', '0.5')")
        kept.close()
        assert problem(service, "GET", f"/v1/plants/p/artifacts/{digest}/manifest")[:2] == (
            500,
            "broken-chain",
        )
        done = command(service, "fetch", "p", str(tmp_path / "model"), check=False)
        assert done.returncode == 4, done.stderr
        client.close()


# -- evidence


def said(artifact, number, **more):
    figures = {"number": number, "samples": "x" * 900_000}
    document = {
        "schema": SCHEMA,
        "artifact": artifact,
        "stage": "SIL",
        "passed": True,
        "shows": "a",
        "cannot_show": "b",
        "figures": figures,
    }
    return document | more


def test_evidence_is_listed_in_pages_that_are_bounded_in_bytes(service, client, plant):
    artifact = client.serving(plant).artifact
    added = [client.add_evidence(plant, said(artifact, number))["digest"] for number in range(12)]
    path, after, found = f"/v1/plants/{plant}/artifacts/{artifact}/evidence", "", []
    while after is not None:
        body = request(service, "GET", f"{path}?after={after}")[2]
        assert len(body) < 4 << 20
        page = json.loads(body)
        assert page["items"]
        found, after = found + page["items"], page["next"]
    assert (
        [e["digest"] for e in found]
        == added
        == [e["digest"] for e in client.evidence(plant, artifact)]
    )
    assert [e["document"]["figures"]["number"] for e in found] == list(range(12))
    few = json.loads(request(service, "GET", f"{path}?limit=1")[2])
    assert ([e["digest"] for e in few["items"]], bool(few["next"])) == (added[:1], True)
    assert (
        json.loads(
            request(service, "GET", f"{path}?limit=1&after={found[-2]['created_at']}_{added[-2]}")[
                2
            ]
        )["next"]
        is None
    )


def test_evidence_that_is_a_book_is_refused(service, client, plant):
    artifact = client.serving(plant).artifact
    for field in ("shows", "cannot_show"):
        body = json.dumps(said(artifact, 0, **{field: "x" * 10_001}))
        status, code, document = problem(
            service, "POST", f"/v1/plants/{plant}/evidence", body, **JSON
        )
        assert (status, code, document["facts"]["field"]) == (422, "bad-evidence", field)
