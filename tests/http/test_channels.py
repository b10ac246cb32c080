"""Channels of serving require evidence, and evidence says what it cannot show."""

import itertools
import json
import queue
import threading
import uuid

import pytest

from tests.http.test_http import problem, request
from tests.support.made import plant_document
from tests.support.service import Service, command
from tests.support.storage import embedded
from trueup_client import Client, Problem

SCOPE = {
    "shows": "tracks a sine on the bench",
    "cannot_show": "payloads above 2 [kg], heat, and [/opt] arms",
}


@pytest.fixture
def plant(client):
    name = f"channels-{uuid.uuid4().hex[:12]}"
    client.register_plant(plant_document(name))
    return name


def refused(act):
    with pytest.raises(Problem) as found:
        act()
    return found.value.code


def test_a_channel_serves_only_with_passed_evidence_of_every_stage_that_it_requires(client, plant):
    artifact = client.serving(plant).artifact
    assert client.declare_channel(plant, "field", ["physical", "HIL"])["requires"] == [
        "HIL",
        "physical",
    ]
    assert refused(lambda: client.channel_serving(plant, "field")) == "not-found"
    assert refused(lambda: client.move_channel(plant, "field", artifact, 0)) == "evidence-missing"
    evidence = {"artifact": artifact, "figures": {"rms_m": 0.01}, **SCOPE}
    client.add_evidence(plant, {**evidence, "stage": "HIL", "passed": True})
    failed = client.add_evidence(plant, {**evidence, "stage": "physical", "passed": False})
    with pytest.raises(Problem) as missing:
        client.move_channel(plant, "field", artifact, 0)
    assert missing.value.facts["stages"] == ["physical"]
    passed = client.add_evidence(plant, {**evidence, "stage": "physical", "passed": True})
    moved = client.move_channel(plant, "field", artifact, 0)
    assert (moved["generation"], moved["version"]) == (1, 1)
    assert moved["evidence"][1] == passed["digest"] != failed["digest"]
    assert client.channel_serving(plant, "field")["artifact"] == artifact
    assert refused(lambda: client.move_channel(plant, "field", artifact, 0)) == "pointer-moved"
    assert [e["stage"] for e in client.evidence(plant, artifact)] == ["HIL", "physical", "physical"]
    kinds = [e["kind"] for e in client.audit(plant)]
    assert (
        kinds.count("evidence:added"),
        kinds.count("channel:declared"),
        kinds.count("channel:moved"),
    ) == (3, 1, 1)


def test_a_robot_on_a_channel_hears_of_its_moves_at_once(tmp_path):
    """A server that looks by itself only every hour answers at the move."""
    hours = {"watch_interval_s": 3600, "long_poll_limit_s": 3600}
    with Service(embedded(tmp_path), **hours).running(worker=False) as service:
        client = Client(service.url)
        plant = client.register_plant(plant_document("p"))["name"]
        follow_a_channel(service, client, plant)
        client.close()


def follow_a_channel(service, client, plant):
    artifact = client.serving(plant).artifact
    client.declare_channel(plant, "staging", [])
    client.move_channel(plant, "staging", artifact, 0)
    heard = queue.Queue()

    def follow():
        robot = Client(service.url)
        for position in itertools.islice(robot.watch_channel(plant, "staging", wait_s=3600.0), 2):
            heard.put(position["generation"])
        robot.close()

    following = threading.Thread(target=follow)
    following.start()
    assert heard.get(timeout=60.0) == 1
    client.move_channel(plant, "staging", artifact, 1)
    assert heard.get(timeout=60.0) == 2  # long before its wait is over
    following.join(60.0)


def test_a_channel_that_did_not_move_is_not_sent_again(plant, client, service):
    client.declare_channel(plant, "field", [])
    client.move_channel(plant, "field", client.serving(plant).artifact, 0)
    there = f"/v1/plants/{plant}/channels/field/serving"
    status, headers, _ = request(service, "GET", there)
    assert (status, headers["etag"]) == (200, '"1"')
    assert request(service, "GET", there, If_None_Match='"1"')[0] == 304
    assert problem(service, "GET", f"{there}?wait_s=-1")[1] == "bad-request"
    assert problem(service, "GET", f"/v1/plants/{plant}/channels/other/serving")[:2] == (
        404,
        "not-found",
    )


def test_what_was_failed_after_it_was_passed_is_failed(client, plant):
    artifact = client.serving(plant).artifact
    client.declare_channel(plant, "staging", ["SIL"])
    evidence = {"artifact": artifact, "stage": "SIL", "figures": {}, **SCOPE}
    client.add_evidence(plant, {**evidence, "passed": True})
    client.add_evidence(plant, {**evidence, "passed": False})
    assert refused(lambda: client.move_channel(plant, "staging", artifact, 0)) == "evidence-missing"


def test_a_channel_never_goes_before_the_plant_itself(client, plant, tmp_path):
    from trueup.artifact.artifact import pack
    from trueup.model.plant import Plant
    from trueup.model.predictor import Identified

    made = pack(
        Identified(Plant.from_document(plant_document(plant)), (1.2, 0.6, 0.8)),
        {"origin": "by hand"},
    )
    added = client.add_artifact(plant, made.manifest, made.arrays)
    client.declare_channel(plant, "staging", [])
    assert (
        refused(lambda: client.move_channel(plant, "staging", added["digest"], 0)) == "never-served"
    )
    assert (
        client.move_channel(plant, "staging", client.serving(plant).artifact, 0)["evidence"] == []
    )


def test_what_a_channel_requires_never_changes(client, plant):
    client.declare_channel(plant, "field", ["HIL"])
    assert client.declare_channel(plant, "field", ["HIL"])["requires"] == ["HIL"]
    assert refused(lambda: client.declare_channel(plant, "field", [])) == "conflict"
    assert refused(lambda: client.declare_channel(plant, "field", ["hope"])) == "invalid-request"


@pytest.mark.parametrize(
    ("spoil", "field"),
    [
        ({"stage": "lab"}, "stage"),
        ({"cannot_show": "  "}, "cannot_show"),
        ({"passed": "yes"}, "passed"),
        ({"artifact": "it"}, "artifact"),
    ],
)
def test_evidence_without_its_scope_is_refused(client, plant, spoil, field):
    sound = {
        "artifact": client.serving(plant).artifact,
        "stage": "SIL",
        "passed": True,
        "figures": {},
        **SCOPE,
    }
    with pytest.raises(Problem) as found:
        client.add_evidence(plant, {**sound, **spoil})
    assert (found.value.code, found.value.facts["field"]) == ("bad-evidence", field)


def test_evidence_of_an_artifact_that_is_not_here_is_refused(client, plant):
    sound = {"artifact": "a" * 64, "stage": "SIL", "passed": True, "figures": {}, **SCOPE}
    assert refused(lambda: client.add_evidence(plant, sound)) == "not-found"


def test_the_commands_add_evidence_and_release_on_a_channel(service, client, plant, tmp_path):
    told = tmp_path / "hil.json"
    told.write_text(
        json.dumps({"stage": "HIL", "passed": True, "figures": {"jitter_ms": 0.3}, **SCOPE})
    )
    assert "no channels" in command(service, "channels", plant).stdout
    command(service, "channels", plant, "--declare", "field", "--requires", "HIL")
    refused = command(service, "release", plant, "field", check=False)
    assert refused.returncode == 1
    assert "evidence-missing" in refused.stderr
    assert "no evidence" in command(service, "evidence", plant).stdout
    said = command(service, "evidence", plant, "--add", str(told)).stdout
    assert "HIL" in said
    assert SCOPE["cannot_show"] in said
    assert "generation 1" in command(service, "release", plant, "field").stdout
    (found,) = json.loads(command(service, "channels", plant, "--json").stdout)
    assert (found["requires"], found["serving"]["version"]) == (["HIL"], 1)
    assert command(service, "release", plant, "fields", check=False).returncode == 1
