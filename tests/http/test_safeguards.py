"""A policy that requires safeguards: what was recorded on a machine is used only where its declared
safeguards can be checked, and held."""

import json

import pytest

from tests.support.made import episode_bytes, plant_document
from trueup.episode.role import Role
from trueup_client import Client
from trueup_client.problem import Problem

BOUND = {"enforced_by": "limit switches", "independent_of": "the controller"}
SAFE = {
    "stage": "physical",
    "safeguards": json.dumps([{"signal": "u", "low": -2.0, "high": 2.0, **BOUND}]),
    "stop_criterion": json.dumps({"signal": "q", "high": 9.0, "within_s": 0.5, **BOUND}),
}


@pytest.fixture
def client(service):
    with Client(service.url) as opened:
        yield opened


@pytest.fixture(scope="module")
def plant(service, tmp_path_factory):
    """A plant whose policy requires safeguards, and its episodes: unsafe, broken, safe,
    simulated."""
    folder, name = tmp_path_factory.mktemp("safe"), "guarded"
    broken = {**SAFE, "safeguards": json.dumps([{"signal": "u", "high": 0.01, **BOUND}])}
    with Client(service.url) as client:
        client.register_plant(plant_document(name))
        digests = []
        for seed, said in enumerate(({"stage": "physical"}, broken, SAFE, {"stage": "MIL"})):
            path = folder / f"{seed}.mcap"
            path.write_bytes(episode_bytes(seed, role=Role.ADAPTATION, **said))
            digests.append(client.upload_episode(name, path)["digest"])
        policy = {"schema": "trueup.policy/1", "gate": client.declare_gate(name)["digest"]}
        client.declare_policy(name, {**policy, "safeguards": "require"})
    return name, digests, policy


def test_a_fit_of_all_episodes_leaves_out_what_shows_no_safeguards(client, plant):
    name, (_, _, safe, simulated), _ = plant
    job = client.submit(name, {"kind": "fit", "method": "identify"})
    assert job["request"]["episodes"] == [safe, simulated]
    client.wait(job["id"])


def test_a_named_episode_that_shows_none_is_refused_with_the_reason(client, plant):
    name, (unsafe, broken, safe, _), _ = plant
    for digest, why in ((unsafe, "does not declare"), (broken, "breaks them")):
        with pytest.raises(Problem, match=why) as refused:
            client.submit(name, {"kind": "fit", "method": "identify", "episodes": [safe, digest]})
        assert (refused.value.status, refused.value.code) == (409, "not-safeguarded")
        assert refused.value.facts["digest"] == digest


def test_a_family_takes_safe_training_episodes_alone_and_does_without_others(service, tmp_path):
    with Client(service.url) as client:
        client.register_plant(plant_document("guarded-family"))
        digests = {}
        unsafe, safe = {"stage": "physical"}, SAFE
        for seed, (name, role, said) in enumerate(
            (
                ("unsafe", Role.TRAINING, unsafe),
                ("safe", Role.TRAINING, safe),
                ("adaptation", Role.ADAPTATION, unsafe),
            )
        ):
            path = tmp_path / f"{seed}.mcap"
            path.write_bytes(episode_bytes(900 + seed, role=role, **said))
            digests[name] = client.upload_episode("guarded-family", path)["digest"]
        gate = client.declare_gate("guarded-family")["digest"]
        policy = {"schema": "trueup.policy/1", "gate": gate, "safeguards": "require"}
        client.declare_policy("guarded-family", policy)
        fit = {"kind": "fit", "method": "blind"}
        with pytest.raises(Problem) as refused:
            client.submit("guarded-family", {**fit, "training": [digests["unsafe"]]})
        assert refused.value.code == "not-safeguarded"
        assert refused.value.facts["digest"] == digests["unsafe"]
        job = client.submit("guarded-family", fit)
        assert (job["request"]["training"], job["request"]["episodes"]) == ([digests["safe"]], [])
        client.wait(job["id"])


def test_the_summary_of_an_episode_says_what_its_safeguards_did(client, plant):
    name, (_, broken, safe, _), _ = plant
    held = {
        digest: client.episode(name, digest)["summary"]["collection"]["safeguards"]["held"]
        for digest in (broken, safe)
    }
    assert held == {broken: False, safe: True}


def test_only_an_admin_may_take_the_requirement_away(service, client, plant):
    name, digests, policy = plant
    token = client.issue_token("op", ["operator"])["token"]
    with Client(service.url, token=token) as operator:
        with pytest.raises(Problem) as refused:
            operator.declare_policy(name, policy)
        assert refused.value.code == "forbidden"
    with pytest.raises(Problem) as wrong:
        client.declare_policy(name, {**policy, "safeguards": "perhaps"})
    assert wrong.value.code == "bad-policy"
    client.declare_policy(name, policy)
    job = client.submit(name, {"kind": "fit", "method": "identify"})
    assert job["request"]["episodes"] == digests
    client.cancel(job["id"])
    client.declare_policy(name, {**policy, "safeguards": "require"})
