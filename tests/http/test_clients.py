"""The client's records and its form for an event loop are made from what is there, and both ask
safely."""

import asyncio
import json
import socket
import subprocess
import sys
import time
import urllib.request
from contextlib import closing
from pathlib import Path

import pytest

from tests.support.made import episode_bytes, plant_document, save
from tests.support.service import ROOT
from trueup_client import AsyncClient, Client, Problem, Unreachable
from trueup_client.problem import DigestMismatch

sys.path.insert(0, str(ROOT / "tools"))
import make_async_client
import make_records


@pytest.fixture
def plant(service):
    name = f"clients-{time.time_ns()}"
    with closing(Client(service.url)) as client:
        client.register_plant(plant_document(name))
    return name


def test_records_are_what_the_service_says_it_answers_with(service):
    with urllib.request.urlopen(f"{service.url}/openapi.json") as answer:
        document = json.load(answer)
    formatted = subprocess.run(
        [Path(sys.executable).parent / "ruff", "format", "--stdin-filename", "records.py", "-"],
        input=make_records.module(document),
        capture_output=True,
        text=True,
        check=True,
        cwd=ROOT,
    ).stdout
    written = (ROOT / "client" / "trueup_client" / "records.py").read_text()
    assert written == formatted, "run tools/make_records.py and format"


def test_the_form_for_an_event_loop_is_made_from_the_client():
    ruff = Path(sys.executable).parent / "ruff"
    modules = make_async_client.modules()
    assert set(modules) == set(make_async_client.WRITTEN.glob("*.py"))
    for path, text in modules.items():
        formatted = subprocess.run(
            [ruff, "format", "--stdin-filename", str(path), "-"],
            input=text,
            capture_output=True,
            text=True,
            check=True,
            cwd=ROOT,
        ).stdout
        assert path.read_text() == formatted, "run tools/make_async_client.py and format"


def test_the_form_for_an_event_loop_has_every_method_of_the_client():
    def calls(kind):
        return {name for name in dir(kind) if not name.startswith("_")}

    assert calls(Client) - calls(AsyncClient) == {"abort", "aborted"}


def test_it_uploads_lists_and_waits(service, plant, tmp_path):
    async def go():
        shares = []
        async with AsyncClient(service.url) as client:
            paths = [save(tmp_path, f"{seed}.mcap", episode_bytes(seed=seed)) for seed in range(3)]
            sent = await asyncio.gather(
                *(client.upload_episode(plant, path, shares.append) for path in paths)
            )
            listed = [e["digest"] async for e in client.episodes(plant)]
            asked = await asyncio.gather(*(client.serving(plant) for _ in range(20)))
            with pytest.raises(Problem, match="not-found"):
                await client.plant("nobody")
            names = [p["name"] async for p in client.plants()]
            async for one in client.plants():
                assert one["name"] in names
                break
        return sent, listed, asked, shares, names

    sent, listed, asked, shares, names = asyncio.run(go())
    assert sorted(listed) == sorted(e["digest"] for e in sent)
    assert {a.version for a in asked} == {1}
    assert max(shares) == 1.0
    assert plant in names


def test_a_watch_that_is_given_up_ends_at_once(service, plant):
    async def go():
        async with AsyncClient(service.url) as client:
            seen = client.watch(plant, wait_s=30.0)
            first = await anext(seen)
            with pytest.raises(TimeoutError):
                await asyncio.wait_for(anext(seen), 0.5)
            after = await client.serving(plant)  # others go on
        return first, after

    # a limit, so that it does not wait for the service, which holds the watch for half a minute
    first, after = asyncio.run(asyncio.wait_for(go(), 25.0))
    assert first == after


def test_whatever_asks_when_it_is_closed_ends(service, plant):
    async def go():
        client = AsyncClient(service.url)
        seen = client.watch(plant, wait_s=30.0)
        await anext(seen)
        waits = asyncio.ensure_future(anext(seen))
        await asyncio.sleep(0.3)
        await client.close()
        with pytest.raises(Unreachable):
            await waits

    asyncio.run(asyncio.wait_for(go(), 20.0))


def test_calls_that_wait_for_their_turn_end_when_it_is_closed_and_none_is_taken_for_cancelled(
    service, plant
):
    async def go():
        client = AsyncClient(service.url, at_once=1)
        first = asyncio.ensure_future(anext(client.watch(plant, wait_s=30.0)))
        await first
        waiting = [asyncio.ensure_future(client.wait("0" * 32)) for _ in range(3)]
        waiting.append(asyncio.ensure_future(anext(client.watch(plant, wait_s=30.0))))
        await client.close()
        ended = await asyncio.gather(*waiting, return_exceptions=True)
        assert all(isinstance(x, Unreachable | Problem) for x in ended), ended
        with pytest.raises(Unreachable):
            await client.plant(plant)

    asyncio.run(asyncio.wait_for(go(), 20.0))


def test_calls_that_are_cancelled_leave_room_for_others(service, plant, tmp_path):
    async def go():
        async with AsyncClient(service.url, at_once=2) as client:
            await client.upload_episode(plant, save(tmp_path, "1.mcap", episode_bytes(seed=1)))
            watches = [client.watch(plant, wait_s=30.0) for _ in range(2)]
            for seen in watches:
                await anext(seen)
            asked = [asyncio.ensure_future(anext(seen)) for seen in watches]
            await asyncio.sleep(0.2)
            for one in asked:
                one.cancel()
            return await asyncio.wait_for(client.plant(plant), 20.0)

    assert asyncio.run(go())["name"] == plant


def test_a_download_that_is_given_up_leaves_the_next_answer_whole(service, plant, tmp_path):
    async def go():
        async with AsyncClient(service.url, at_once=2) as client:
            digest = (
                await client.upload_episode(plant, save(tmp_path, "1.mcap", episode_bytes(seed=1)))
            )["digest"]
            for _ in range(50):
                parts = client.episode_parts(plant, digest)
                await anext(parts)
                record, _ = await asyncio.gather(client.plant(plant), parts.aclose())
                assert record["name"] == plant

    asyncio.run(go())


def test_what_must_not_be_repeated_is_never_sent_over_a_connection_that_may_be_closed(
    service,
):
    with closing(Client(service.url)) as client:
        list(client.plants())
        client._connection._http.sock.shutdown(socket.SHUT_RDWR)
        assert client.issue_token(f"after-{time.time_ns()}", ["engineer"])["token"]


def test_a_key_of_ones_own_makes_one_job_of_a_request_sent_twice(service, plant, tmp_path):
    with closing(Client(service.url)) as one, closing(Client(service.url)) as other:
        one.upload_episode(plant, save(tmp_path, "1.mcap", episode_bytes(seed=1)))
        request = {"kind": "fit", "method": "identify"}
        first, again = (
            one.submit(plant, request, key="mine"),
            other.submit(plant, request, key="mine"),
        )
        assert first["id"] == again["id"]
        assert one.submit(plant, request)["id"] != first["id"]
        with pytest.raises(Problem, match="idempotency-key-reused"):
            other.submit(plant, {"kind": "fit", "method": "residual"}, key="mine")


def test_a_token_whose_answer_was_lost_is_not_issued_twice(service, monkeypatch):
    with closing(Client(service.url)) as client:
        list(client.tokens())
        asked = []
        monkeypatch.setattr(
            client._connection._http,
            "getresponse",
            lambda: asked.append(1) or (_ for _ in ()).throw(ConnectionResetError()),
        )
        with pytest.raises(Unreachable):
            client.issue_token(f"lost-{time.time_ns()}", ["engineer"])
        assert len(asked) == 1


def test_a_list_whose_pages_never_end_is_not_followed_for_ever(monkeypatch):
    client = Client("http://127.0.0.1:9")
    monkeypatch.setattr(client, "_get", lambda _path: {"items": [1], "next": "again"})
    with pytest.raises(DigestMismatch, match="a list has an end"):
        list(client.plants())
    client.close()
