"""What people do wrong at the command, each told with what to do next, in words or as JSON, and
never as a traceback."""

import json
import time
from contextlib import closing

import pytest

from tests.support.completion import completed
from tests.support.made import TRUE, episode_bytes, identified, plant_document, save
from tests.support.service import ADMIN, command
from trueup.episode.role import Role
from trueup_client import Client

pytestmark = pytest.mark.parametrize("service", ["embedded"], indirect=True)


@pytest.fixture
def plant(service):
    name = f"stumbles-{time.time_ns()}"
    with closing(Client(service.url)) as client:
        client.register_plant(plant_document(name))
    return name


@pytest.fixture
def wrong(service):
    def told(*arguments):
        """What is printed, and as JSON."""
        said = command(service, *map(str, arguments), check=False)
        assert (said.returncode, said.stdout, "Traceback" in said.stderr) == (1, "", False), (
            said.stderr
        )
        document = command(service, *map(str, arguments), "--json", check=False)
        assert document.returncode == 1
        found = json.loads(document.stdout)
        assert any(line.startswith(found["code"] + " ") for line in said.stderr.splitlines())
        return said.stderr, found

    return told


def test_files_that_are_not_there_or_not_json_are_named(wrong, plant, tmp_path):
    (tmp_path / "plant.json").write_bytes(b"\x89\xff not json")
    (tmp_path / "bare").mkdir()
    assert "nothere.mcap" in wrong("upload", plant, tmp_path / "nothere.mcap")[0]
    candidate = identified(plant).digest
    rules = wrong("gate", plant, candidate, "--rules", tmp_path / "nothere.json")
    assert (rules[1]["code"], "nothere.json" in rules[0]) == ("file", True)
    assert wrong("plant", "register", tmp_path / "plant.json")[1]["code"] == "bad-plant"
    assert "plant.json" in wrong("plant", "register", tmp_path / "bare")[0]
    assert "holds no *.mcap" in wrong("upload", plant, tmp_path / "bare")[0]
    assert (
        "there is no folder"
        in wrong("diagnose", tmp_path / "nowhere", "--out", tmp_path / "out")[0]
    )


def test_the_broken_one_of_several_recordings_is_named_and_what_is_no_mcap_is_told_so(
    wrong, plant, tmp_path
):
    whole, case = episode_bytes(1), tmp_path / "case"
    case.mkdir()
    (case / "plant.json").write_text(json.dumps(plant_document()))
    save(case, "a.mcap", whole)
    save(case, "b.mcap", whole[: len(whole) // 2])
    for arguments in (("upload", plant, case), ("diagnose", case, "--out", tmp_path / "out")):
        text, document = wrong(*arguments)
        assert "b.mcap" in text
        assert document["facts"]["byte"] > 0
    save(tmp_path, "c.mcap", b"t,q\n" * 100)
    assert "This is not an MCAP file" in wrong("upload", plant, tmp_path / "c.mcap")[0]


def test_digests_may_be_short_and_a_candidate_is_no_decision(
    service, client, wrong, plant, tmp_path
):
    for seed, role in enumerate([Role.ADAPTATION, Role.VALIDATION]):
        client.upload_episode(plant, save(tmp_path, f"{role}.mcap", episode_bytes(seed, role=role)))
    candidate = client.add_artifact(plant, identified(plant, k=TRUE[0]).manifest)["digest"]
    assert "no version begins" in wrong("gate", plant, "0" * 12)[0]
    assert "2 versions begin" in wrong("gate", plant, "")[0]
    assert f"trueup gate {plant}" in wrong("promote", plant, candidate[:12])[1]["hint"]
    judged = command(service, "gate", plant, candidate[:12]).stdout
    assert "every window of 2 s in 1 held-out episode" in judged
    decision = json.loads(command(service, "decisions", plant, "--json").stdout)[0]["digest"]
    assert (
        f"trueup promote {plant} {decision[:12]}" in wrong("promote", plant, candidate)[1]["hint"]
    )
    promoted = command(service, "promote", plant, decision[:12]).stdout
    assert promoted == command(service, "promote", plant, decision).stdout  # it serves already
    assert candidate[:12] in command(service, "versions", plant).stdout
    assert json.loads(
        command(service, "audit", "provenance", plant, candidate[:12], "--json").stdout
    )
    command(service, "fetch", plant, str(tmp_path / "model"), "--artifact", candidate[:12])


def test_names_and_tokens_that_nobody_knows_lead_on(service, wrong, monkeypatch, tmp_path):
    assert "trueup plant list" in wrong("serving", "nobody")[1]["hint"]
    assert wrong("audit", "nobody")[1]["code"] == "not-found"
    monkeypatch.delenv("TRUEUP_TOKEN")
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    assert "TRUEUP_DATA_DIR" in wrong("plant", "list")[1]["hint"]


def test_a_shell_completes_names_of_plants_and_takes_none_where_nobody_answers(
    service, plant, tmp_path
):
    script = tmp_path / "completion.sh"
    script.write_text(command(service, "completion", "bash").stdout)
    line = f"trueup serving --plant {plant[:10]}"
    assert plant in completed(line, script, TRUEUP_URL=service.url, TRUEUP_TOKEN=ADMIN)
    assert completed(line, script, TRUEUP_URL="http://127.0.0.1:9") == []


def test_a_gate_says_what_it_needs_and_a_case_is_not_written_over(service, wrong, plant, tmp_path):
    (tmp_path / "gate.json").write_text("{}")
    candidate = json.loads(command(service, "versions", plant, "--json").stdout)[0]["digest"]
    assert (
        "a gate needs 'schema'"
        in wrong("gate", plant, candidate, "--rules", tmp_path / "gate.json")[0]
    )
    bag, case = tmp_path / "bag", tmp_path / "case"
    bag.mkdir()
    for seed in range(3):
        save(
            bag,
            f"{seed}.mcap",
            episode_bytes(seed, role=Role.VALIDATION if seed == 2 else Role.ADAPTATION),
        )
    command(service, "init", str(bag), "--out", str(case))
    (case / "plant.json").write_text("{}")
    assert "holds a plant.json already" in wrong("init", bag, "--out", case)[0]
    assert (case / "plant.json").read_text() == "{}"
    command(service, "init", str(bag), "--out", str(case), "--force")
    assert len(list(case.glob("*.mcap"))) == 3
    assert "among the recordings" in wrong("init", bag, "--out", bag)[0]
