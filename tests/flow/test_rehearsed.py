"""The way back is rehearsed when a candidate is accepted; a promotion relies on that only while it
still says something."""

import asyncio

import pytest

from tests.support.gates import LENIENT
from tests.support.made import episode_bytes, plant_document, save
from tests.support.service import Service
from trueup.episode.role import Role
from trueup_client import Client
from trueup_service.actions import promotion
from trueup_service.actor_context import ActorContext
from trueup_service.errors import SwitchbackFailed

CONTEXT = ActorContext("tester", "2027-01-01T00:00:00.000000Z")


@pytest.fixture
def accepted(storage, tmp_path):
    """A client, its service's parts, and a plant that serves a model with arrays, with an accepted
    decision on another one."""
    service, parts = Service(storage), storage.build()
    with service.running(), Client(service.url) as client:
        client.register_plant(plant_document("p"))
        for seed, role in ((0, Role.ADAPTATION), (1, Role.VALIDATION)):
            client.upload_episode(
                "p", save(tmp_path, f"{seed}.mcap", episode_bytes(seed, role=role))
            )
        gate = client.declare_gate("p", LENIENT)["digest"]
        decisions = []
        for method in ("residual", "identify"):
            fit = client.wait(client.submit("p", {"kind": "fit", "method": method})["id"])
            trial = {"kind": "gate", "candidate": fit["result"]["artifact"], "gate": gate}
            judged = client.wait(client.submit("p", trial)["id"])["result"]
            assert judged["accepted"]
            decisions.append(judged["decision"])
            if method == "residual":
                client.promote("p", decisions[0], 1)
        yield client, parts, decisions
    parts.close()


def facts_of(client, kind, subject):
    return next(
        e["facts"]
        for e in reversed(list(client.audit("p")))
        if e["kind"] == kind and subject in (e["subject"], e["facts"].get("decision"))
    )


def test_the_record_that_was_made_with_the_decision_is_that_of_the_move(accepted, monkeypatch):
    client, _, decisions = accepted
    client.promote("p", decisions[1], 2)
    made = facts_of(client, "decision:made", decisions[1])["rehearsed"]
    assert made["loads"]
    assert facts_of(client, "pointer:moved", decisions[1])["rehearsed"] == made


def test_other_code_rehearses_again(accepted, monkeypatch):
    client, parts, decisions = accepted
    monkeypatch.setattr(promotion, "code_identity", lambda: {"version": "another"})
    asyncio.run(promotion.promote(parts, CONTEXT, "p", decisions[1], 2, None))
    made = facts_of(client, "decision:made", decisions[1])["rehearsed"]
    moved = facts_of(client, "pointer:moved", decisions[1])["rehearsed"]
    assert (made["artifact"], made["at"] < moved["at"]) == (moved["artifact"], True)


def test_a_way_back_that_was_damaged_since_is_refused(accepted, monkeypatch):
    client, parts, decisions = accepted
    arrays = client.version("p", 2)["arrays"]
    whole = type(parts.blobs).get

    def damaged(blobs, digest):
        return whole(blobs, digest)[:-1] + b"\x01" if digest == arrays else whole(blobs, digest)

    monkeypatch.setattr(type(parts.blobs), "get", damaged)
    with pytest.raises(SwitchbackFailed):
        asyncio.run(promotion.promote(parts, CONTEXT, "p", decisions[1], 2, None))
    assert client.serving("p").generation == 2
