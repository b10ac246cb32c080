"""What is kept is its owner's alone, and what is kept for a while goes by its documented age and no
sooner."""

import hashlib
import json
import logging
import os
import stat
import uuid
from contextlib import closing
from datetime import UTC, datetime, timedelta

import pytest

from tests.http.test_http import problem, request
from tests.support.made import episode_bytes, plant_document
from tests.support.service import Service
from tests.support.storage import Storage, embedded
from tests.unit.episode.test_clocks import relogged
from trueup_client import Client
from trueup_service.expiry import remove_expired

JSON = {"Content_Type": "application/json"}


def mode(path):
    return stat.S_IMODE(path.stat().st_mode)


def loose(folder):
    return [
        path.name for path in [folder, *folder.glob("*")] if path.is_file() and mode(path) & 0o077
    ]


# -- permissions


def test_a_fresh_data_folder_is_its_owners_alone(tmp_path):
    with Service(embedded(tmp_path / "data")).running(worker=False) as service:
        with closing(Client(service.url)) as client:
            client.register_plant(plant_document("p"))
        assert mode(tmp_path / "data") == 0o700
        assert {"trueup.sqlite", "trueup.sqlite-wal", "trueup.sqlite-shm", "signing.key"} <= set(
            os.listdir(tmp_path / "data")
        )
        assert loose(tmp_path / "data") == []


def test_a_data_folder_that_others_may_read_is_closed_at_the_start_and_the_log_says_so(
    tmp_path, caplog
):
    data, storage = tmp_path / "data", embedded(tmp_path / "data")
    with Service(storage).running(worker=False) as service:
        request(service, "GET", "/healthz")
    names = ["trueup.sqlite", "signing.key"]
    (data / "admin.token").write_text("x")
    for name in [*names, "admin.token"]:
        (data / name).chmod(0o644)
    data.chmod(0o755)
    with caplog.at_level(logging.WARNING):
        storage.build().close()
    assert mode(data) == 0o700
    assert {mode(data / name) for name in [*names, "admin.token"]} == {0o600}
    assert {(record.path, record.mode) for record in caplog.records} >= {
        (str(data), "0755"),
        (str(data / "signing.key"), "0644"),
    }
    caplog.clear()
    storage.build().close()
    assert not caplog.records


# -- answers of idempotency keys


def gate(number):
    rules = [{"rule": "rollout_improves", "ratio": 1.0 / (1 + number)}]
    return json.dumps(
        {
            "schema": "trueup.gate/1",
            "rules": rules,
            "scoring": {"horizon_s": 2.0, "windows": "first"},
        }
    )


@pytest.fixture
def few(storage):
    """A service that keeps five answers of each token, with two other tokens; and what it is built
    of."""
    with Service(Storage(storage.name, storage.environment | {"TRUEUP_ANSWERS_KEPT": "5"})).running(
        worker=False
    ) as service:
        parts = Storage(storage.name, storage.environment | {"TRUEUP_ANSWERS_KEPT": "5"}).build()
        with closing(Client(service.url)) as client:
            client.register_plant(plant_document("p"))
            other = client.issue_token("other", ["engineer"])["token"]
        yield service, parts, other
        parts.close()


def test_a_tokens_oldest_answers_go_beyond_those_that_are_kept_and_no_others(few):
    service, parts, other = few
    path, keys = "/v1/plants/p/gates", [uuid.uuid4().hex for _ in range(8)]
    theirs = uuid.uuid4().hex
    assert (
        request(
            service,
            "POST",
            path,
            gate(0),
            Idempotency_Key=theirs,
            Authorization=f"Bearer {other}",
            **JSON,
        )[0]
        == 201
    )
    for number, key in enumerate(keys):
        assert request(service, "POST", path, gate(number), Idempotency_Key=key, **JSON)[0] in (
            200,
            201,
        )
    remove_expired(parts)
    remove_expired(parts)
    for key in keys[3:]:
        assert problem(service, "POST", path, gate(99), Idempotency_Key=key, **JSON)[:2] == (
            409,
            "idempotency-key-reused",
        )
    assert (
        problem(
            service,
            "POST",
            path,
            gate(99),
            Idempotency_Key=theirs,
            Authorization=f"Bearer {other}",
            **JSON,
        )[0]
        == 409
    )
    for key in keys[:3]:
        assert request(service, "POST", path, gate(99), Idempotency_Key=key, **JSON)[0] in (
            200,
            201,
        )


def test_answers_go_by_their_age_and_no_sooner(few):
    service, parts, _ = few
    path, key = "/v1/plants/p/gates", uuid.uuid4().hex
    assert request(service, "POST", path, gate(0), Idempotency_Key=key, **JSON)[0] == 201
    remove_expired(parts, datetime.now(UTC) + timedelta(days=6.9))
    assert problem(service, "POST", path, gate(1), Idempotency_Key=key, **JSON)[0] == 409
    remove_expired(parts, datetime.now(UTC) + timedelta(days=7.1))
    assert request(service, "POST", path, gate(1), Idempotency_Key=key, **JSON)[0] == 201


# -- uploads in parts


@pytest.fixture
def small(tmp_path):
    """A service that lets a plant have three uploads and 100 000 bytes under way."""
    storage = embedded(tmp_path / "data")
    limits = {"TRUEUP_UPLOADS_UNDER_WAY": "3", "TRUEUP_UPLOADS_UNDER_WAY_BYTES": "100000"}
    storage = Storage("small", storage.environment | limits)
    with Service(storage).running(worker=False) as service:
        parts = storage.build()
        with closing(Client(service.url)) as client:
            client.register_plant(plant_document("p"))
            client.register_plant(plant_document("other"))
        yield service, parts
        parts.close()


def upload(name, plant="p"):
    return f"/v1/plants/{plant}/uploads/{hashlib.sha256(name.encode()).hexdigest()}"


def sent(service, path, data, offset=0):
    status, _, body = request(service, "PATCH", path, data, Upload_Offset=str(offset))
    return status, json.loads(body).get("code") or json.loads(body)["offset_bytes"]


def test_a_plant_has_so_many_uploads_under_way_and_goes_on_with_those(small):
    service, _ = small
    for name in "abc":
        assert sent(service, upload(name), b"x" * 10) == (200, 10)
    assert sent(service, upload("d"), b"x" * 10) == (429, "uploads-full")
    assert sent(service, upload("d", "other"), b"x" * 10) == (200, 10)
    assert sent(service, upload("a"), b"x" * 10, 10) == (200, 20)
    assert problem(service, "POST", f"{upload('a')}/finish")[:2] == (422, "digest-mismatch")
    assert sent(service, upload("d"), b"x" * 10) == (200, 10)


def test_a_plants_uploads_have_so_many_bytes_together_and_what_was_acknowledged_stays(small):
    service, _ = small
    assert sent(service, upload("a"), b"x" * 60_000) == (200, 60_000)
    assert sent(service, upload("b"), b"x" * 60_000) == (429, "uploads-full")
    assert sent(service, upload("b"), b"x" * 60_000, offset_of(service, "b")) == (
        429,
        "uploads-full",
    )
    assert offset_of(service, "a") == 60_000
    assert sent(service, upload("a"), b"x" * 60_000, 60_000)[0] == 429
    assert offset_of(service, "a") + offset_of(service, "b") <= 100_000


def offset_of(service, name):
    return json.loads(request(service, "GET", upload(name))[2])["offset_bytes"]


def test_an_upload_goes_by_its_age_and_no_sooner(small, tmp_path):
    service, parts = small
    for name in "ab":
        assert sent(service, upload(name), b"x" * 10) == (200, 10)
    held = [path for path in (tmp_path / "data" / "uploads").rglob("*") if path.is_file()]
    now = datetime.now(UTC).timestamp()
    for path, days in zip(held, (6.9, 7.1), strict=True):
        os.utime(path, (now - days * 86_400,) * 2)
    remove_expired(parts)
    assert [path.exists() for path in held] == [True, False]


def test_an_upload_that_began_when_all_were_in_one_folder_goes_on(small, tmp_path):
    service, _ = small
    name = hashlib.sha256(b"a").hexdigest()
    (tmp_path / "data" / "uploads").mkdir(mode=0o700)
    (tmp_path / "data" / "uploads" / hashlib.sha256(f"p\n{name}".encode()).hexdigest()).write_bytes(
        b"x" * 10
    )
    assert offset_of(service, "a") == 10
    assert sent(service, upload("a"), b"x" * 10, 10) == (200, 20)


# -- what a recording says of its clocks


def test_an_episode_whose_clocks_contradict_each_other_is_kept_with_a_warning(service, client):
    plant = f"p{uuid.uuid4().hex[:12]}"
    client.register_plant(plant_document(plant))
    for data, told in (
        (episode_bytes(1), False),
        (relogged(episode_bytes(2), lambda t: 0 * t), True),
    ):
        status, _, body = request(service, "POST", f"/v1/plants/{plant}/episodes", data)
        assert status == 201
        warnings = json.loads(body)["summary"]["collection"]["warnings"]
        assert any("stand still" in warning for warning in warnings) == told
