"""From MCAP bytes to a moved pointer and a verified log, by the command, on both storages."""

import json

import numpy as np
import pytest

from tests.support.made import TRUE, episode_bytes, plant_document, save
from tests.support.service import command
from trueup.canonical import digest_of
from trueup.episode.role import Role
from trueup.fit.score import Score
from trueup.gate.decision import Gate
from trueup.gate.rule import Trial
from trueup.ledger.audit import AuditEntry, rebuild
from trueup_client.proof import Checkpoint, Key


@pytest.fixture(scope="module")
def flow(service, tmp_path_factory):
    """The whole flow by the command; what each step printed as JSON."""
    from pathlib import Path

    case = Path(__file__).parents[2] / "examples" / "emps"
    work = tmp_path_factory.mktemp("flow")
    said = {}

    def run(*arguments):
        return json.loads(command(service, *arguments, "--json").stdout)

    said["plant"] = run("plant", "register", str(case))
    said["episodes"] = run("upload", "emps", str(case))
    said["identified"] = run("fit", "emps")["result"]["artifact"]
    said["friction"] = run(
        "fit", "emps", "--method", "residual", "--features", "1,v,u,sign(v),abs(v)"
    )["result"]["artifact"]
    said["accepted"] = run("gate", "emps", said["friction"], "--rules", str(case / "gate.json"))
    said["promoted"] = run("promote", "emps", said["accepted"]["digest"])[0]
    said["rejected"] = run("gate", "emps", said["identified"], "--rules", str(case / "gate.json"))
    said["serving"] = run("serving", "emps")[0]
    command(service, "fetch", "emps", str(work / "model"))
    arguments = (
        "--model",
        str(work / "model"),
        "--episode",
        str(case / "3-validation.mcap"),
        "--horizon",
        "1.0",
    )
    command(service, "predict", *arguments, "--out", str(work / "after.csv"))
    command(service, "predict", *arguments, "--out", str(work / "before.csv"), "--nominal")
    said["replays"] = [run("replay", said[which]["digest"]) for which in ("accepted", "rejected")]
    said["rolled_back"] = run("rollback", "emps")[0]
    said["history"] = run("serving", "emps", "--history")
    said["audit"] = run("audit", "emps")
    return said, work


def test_all_recordings_are_in(flow):
    assert [e["role"] for e in flow[0]["episodes"]] == ["adaptation"] * 3 + ["validation"] * 2


def test_the_gate_accepts_the_better_and_rejects_the_worse(flow):
    said, _ = flow
    assert said["accepted"]["accepted"] is True
    assert said["rejected"]["accepted"] is False
    assert len(said["rejected"]["document"]["verdicts"]) == 3


def test_what_was_promoted_serves_and_what_was_before_serves_again(flow):
    said, _ = flow
    assert said["serving"] == said["promoted"]
    assert said["serving"]["artifact"] == said["friction"]
    assert [(m["generation"], m["version"], m["move"]) for m in said["history"]] == [
        (1, 1, "registered"),
        (2, 3, "promoted"),
        (3, 1, "rolled_back"),
    ]
    assert said["rolled_back"]["artifact"] == said["history"][0]["artifact"]


def test_the_served_model_predicts_held_out_data_twenty_times_better(flow):
    from trueup.episode.mcap import read_episode
    from trueup.model.plant import Plant

    said, work = flow
    from pathlib import Path

    episode = read_episode(
        (Path(__file__).parents[2] / "examples/emps/3-validation.mcap").read_bytes(),
        Plant.from_document(said["plant"]["document"]).layout,
    )
    errors = {}
    for which in ("before", "after"):
        header = (work / f"{which}.csv").read_text().splitlines()[0]
        rows = np.loadtxt(work / f"{which}.csv", delimiter=",", skiprows=1)
        assert header == "t,q"
        assert np.array_equal(rows[:, 0], episode.t_s)
        scored = episode.t_s >= 1.0  # the first window starts before the velocity can be known
        errors[which] = float(
            np.sqrt(np.mean((rows[scored, 1] - episode.observations[scored, 0]) ** 2))
        )
    assert errors["after"] < 0.0012
    assert errors["after"] < errors["before"] / 20


def test_every_decision_recomputes(flow):
    assert [(r["agrees"], r["differences"]) for r in flow[0]["replays"]] == [(True, []), (True, [])]


def test_the_log_tells_the_whole_story_and_verifies(flow, service):
    kinds = [e["kind"] for e in flow[0]["audit"]]
    assert kinds[:6] == ["plant:registered", *["episode:ingested"] * 5]
    assert kinds.count("decision:made") == 2
    assert kinds.count("pointer:moved") == 2
    assert {e["actor"] for e in flow[0]["audit"]} == {"admin for commander"}
    verified = json.loads(command(service, "audit", "verify", "--json").stdout)
    assert (verified["findings"], verified["decisions"], verified["recomputed"]) == ([], 2, 2)


def test_the_log_alone_rebuilds_every_decision(flow):
    """An auditor needs no other table: from the entries of the gate and of the decision, with its
    figures, each verdict comes out again."""
    entries = flow[0]["audit"]
    gates = {e["subject"]: e["facts"]["gate"] for e in entries if e["kind"] == "gate:declared"}
    made = {e["subject"]: e["facts"]["decision"] for e in entries if e["kind"] == "decision:made"}
    assert {digest_of(gate) for gate in gates.values()} == set(gates)
    assert {digest_of(decision) for decision in made.values()} == set(made)
    assert sorted(decision["accepted"] for decision in made.values()) == [False, True]
    for decision in made.values():
        gate = Gate.from_document(gates[decision["gate"]])
        candidate, incumbent = (
            Score(*(np.array(decision["figures"][which][x]) for x in ("rollout", "one_step")))
            for which in ("candidate", "incumbent")
        )
        episodes = tuple(decision["episodes"])
        trial = Trial(candidate, incumbent, episodes, ((),) * len(episodes), (), None)
        rebuilt = [rule(trial) for rule in gate.rules]
        for again, verdict in zip(rebuilt, decision["verdicts"], strict=True):
            assert (again.rule, again.passed) == (verdict["rule"], verdict["passed"])
            assert again.value == pytest.approx(verdict["value"], rel=1e-12)
            assert again.threshold == pytest.approx(verdict["threshold"], rel=1e-12)
        assert decision["accepted"] is all(again.passed for again in rebuilt)


def test_the_command_prints_tables_for_people(flow, service):
    assert "rolled_back" in command(service, "serving", "emps", "--history").stdout
    assert "episode:ingested" in command(service, "audit").stdout
    assert "emps" in command(service, "plant", "list").stdout


def test_a_refusal_says_what_to_do_next_and_exits_1(flow, service):
    done = command(service, "promote", "emps", flow[0]["rejected"]["digest"], check=False)
    assert done.returncode == 1
    assert "decision-rejected" in done.stderr
    assert "verdicts" in done.stderr


def test_a_service_that_is_not_there_exits_3(service):
    done = command(service, "serving", "emps", "--url", "http://127.0.0.1:9", check=False)
    assert done.returncode == 3
    assert "trueup serve" in done.stderr


def test_a_decision_that_was_tampered_with_is_not_reproduced(client, tmp_path):
    """The replay recomputes from bytes: a figure that was changed in the record is found."""
    from trueup.gate.recompute import differences
    from trueup_cli.replay import recompute

    name = "tampered"
    client.register_plant(plant_document(name))
    for seed, role in ((0, Role.ADAPTATION), (1, Role.VALIDATION)):
        client.upload_episode(
            name, save(tmp_path, f"{seed}.mcap", episode_bytes(seed, role=role, parameters=TRUE))
        )
    candidate = client.wait(client.submit(name, {"kind": "fit", "method": "identify"})["id"])[
        "result"
    ]["artifact"]
    gate = client.declare_gate(name)["digest"]
    decision = client.wait(
        client.submit(name, {"kind": "gate", "candidate": candidate, "gate": gate})["id"]
    )["result"]["decision"]
    recorded = client.decision(name, decision)["document"]
    recomputed = recompute(client, name, recorded, tmp_path, lambda *_: None)
    assert differences(recorded, recomputed) == []
    found = client.wait(client.submit(name, {"kind": "recompute", "decision": decision})["id"])[
        "result"
    ]
    assert (found["agrees"], found["differences"]) == (True, [])
    recorded["figures"]["incumbent"]["rollout"][0] *= 1 + 1e-6
    recorded["verdicts"][0]["passed"] = False
    assert {d.split(":")[0] for d in differences(recorded, recomputed)} == {
        "verdicts[0].passed",
        "figures.incumbent.rollout[0]",
    }


def test_the_audit_entries_have_the_root_that_is_signed(client):
    seen = Checkpoint.of(client.checkpoint(), Key.from_text(client.audit_key()))
    tree = rebuild(AuditEntry(**e) for e in client.audit() if e["sequence"] <= seen.size)
    assert (tree.size, tree.root()) == (seen.size, seen.root)
