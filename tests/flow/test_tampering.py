"""Whoever edits the database is found: by the replay, by the log's verification, or before a
pointer moves."""

import json
import sqlite3
import time
from concurrent.futures import ThreadPoolExecutor

import pytest

from tests.flow.test_failures import until
from tests.support.gates import LENIENT, declare_lenient
from tests.support.made import episode_bytes, identified, plant_document, save
from tests.support.service import Service, command
from tests.support.storage import embedded
from trueup.episode.role import Role
from trueup.ledger.verification import verify
from trueup_client import Client, Problem
from trueup_service.installation import Installation


@pytest.fixture(scope="module")
def told(tmp_path_factory):
    """A service with an accepted and a rejected decision and a moved pointer, and its database's
    file."""
    folder = tmp_path_factory.mktemp("tampering")
    service = Service(embedded(folder / "data"))
    with service.running():
        client = Client(service.url)
        client.register_plant(plant_document("p"))
        for seed, role in ((0, Role.ADAPTATION), (1, Role.VALIDATION)):
            client.upload_episode("p", save(folder, f"{seed}.mcap", episode_bytes(seed, role=role)))
        candidate = client.wait(client.submit("p", {"kind": "fit", "method": "residual"})["id"])[
            "result"
        ]["artifact"]
        other = client.add_artifact("p", identified("p").manifest)["digest"]
        never = [{"rule": "rollout_improves", "ratio": 1e-12}]
        decisions = []
        for judged, rules in ((candidate, LENIENT["rules"]), (other, never)):
            gate = declare_lenient(client, "p", rules=rules)["digest"]
            job = client.submit("p", {"kind": "gate", "candidate": judged, "gate": gate})
            decisions.append(client.wait(job["id"])["result"]["decision"])
        client.promote("p", decisions[0], 1)
        yield service, folder / "data", client, decisions
        client.close()


@pytest.fixture
def edited(told):
    """Run an edit of a row, which is returned as it was, and undo it at the end."""
    _, folder, _, _ = told
    kept = sqlite3.connect(folder / "trueup.sqlite")
    undo = []

    def edit(table, column, value, where):
        chosen = kept.execute(f"SELECT rowid, {column} AS before, * FROM {table} WHERE {where}")
        chosen.row_factory = sqlite3.Row
        whole = chosen.fetchone()
        row, before = whole["rowid"], whole["before"]
        undo.append((table, column, before, row))
        kept.execute(
            f"UPDATE {table} SET {column} = ? WHERE rowid = ?",
            (value(before) if callable(value) else value, row),
        )
        kept.commit()
        return dict(whole)

    yield edit
    for table, column, value, row in reversed(undo):
        kept.execute(f"UPDATE {table} SET {column} = ? WHERE rowid = ?", (value, row))
    kept.commit()
    kept.close()


def findings(service):
    """What the verification finds, in this process."""
    parts = service.storage.build()
    found = verify(Installation(parts.database, parts.blobs)).findings
    parts.close()
    return found


def changed(path, value):
    def change(text):
        document = json.loads(text)
        *parents, last = path
        at = document
        for key in parents:
            at = at[key]
        at[last] = value
        return json.dumps(document, separators=(",", ":"), sort_keys=True)

    return change


def test_before_any_edit_all_agrees(told):
    service, _, _, decisions = told
    assert command(service, "audit", "verify", "--no-replay", check=False).returncode == 0
    assert command(service, "replay", decisions[0], check=False).returncode == 0


@pytest.mark.parametrize(
    ("column", "value"),
    [
        ("document", changed(["generation"], 7)),
        ("document", changed(["figures", "candidate", "rollout"], [0.0])),
        ("document", changed(["verdicts", 0, "because"], "trust me")),
        ("accepted", 0),
        ("candidate", "0" * 64),
        ("generation", 9),
    ],
)
def test_an_edited_decision_is_found_by_replay_and_by_verification(told, edited, column, value):
    service, _, _, decisions = told
    edited("decisions", column, value, f"digest = '{decisions[0]}'")
    assert command(service, "replay", decisions[0], check=False).returncode == 4
    assert [f.where for f in findings(service)] == [f"decisions/{decisions[0]}"]


@pytest.mark.parametrize(
    ("table", "column", "value", "where", "said"),
    [
        ("audit", "facts", changed(["kind"], "other"), "kind = 'job:submitted'", "log"),
        ("audit", "actor", "somebody", "sequence = 2", "log"),
        ("moves", "artifact", "0" * 64, "generation = 2", "moves/p/2"),
        ("moves", "actor", "somebody", "generation = 2", "moves/p/2"),
        ("artifacts", "kind", "identified", "version = 2", "artifacts/p/2"),
        (
            "artifacts",
            "manifest",
            lambda text: text.replace("residual", "residuaL", 1),
            "version = 2",
            "artifacts/p/2",
        ),
        ("plants", "document", changed(["evaluation", "horizon_s"], 9.0), "name = 'p'", "plants/p"),
        ("episodes", "role", "test", "role = 'validation'", "episodes/p/{digest}"),
        (
            "gates",
            "document",
            changed(["scoring", "horizon_s"], 9.0),
            "document LIKE '%one_step%'",
            "gates/p/{digest}",
        ),
    ],
)
def test_an_edited_row_is_found_by_verification_and_named(
    told, edited, table, column, value, where, said
):
    row = edited(table, column, value, where)
    assert [f.where for f in findings(told[0])] == [said.format_map(row)]


def test_what_differs_ends_the_command_with_4_and_is_listed(told, edited):
    edited(
        "gates", "document", changed(["scoring", "horizon_s"], 9.0), "document LIKE '%one_step%'"
    )
    done = command(told[0], "audit", "verify", "--no-replay", check=False)
    assert (done.returncode, "gates/p/" in done.stdout) == (4, True)


def test_a_rejected_decision_that_was_edited_to_accepted_moves_nothing(told, edited):
    _, _, client, decisions = told
    edited("decisions", "accepted", 1, f"digest = '{decisions[1]}'")
    with pytest.raises(Problem) as refused:
        client.promote("p", decisions[1], 2)
    assert refused.value.code == "decision-rejected"
    edited("decisions", "document", changed(["accepted"], True), f"digest = '{decisions[1]}'")
    with pytest.raises(Problem) as refused:
        client.promote("p", decisions[1], 2)
    assert refused.value.code == "broken-chain"
    assert client.serving("p").generation == 2


def test_damaged_bytes_end_a_replay_with_4_and_come_right_when_they_are_sent_again(told, tmp_path):
    service, folder, client, decisions = told
    data = episode_bytes(1, role=Role.VALIDATION)
    digest = next(client.episodes("p", "validation"))["digest"]
    blob = folder / "blobs" / digest[:2] / digest[2:]
    blob.write_bytes(data[:-1] + b"\x01")
    done = command(service, "replay", decisions[0], check=False)
    assert done.returncode == 4
    assert "digest" in done.stderr
    client.upload_episode("p", save(tmp_path, "again.mcap", data))
    assert command(service, "replay", decisions[0], check=False).returncode == 0


def test_an_actors_name_is_printed_as_it_is(told):
    service, _, _, _ = told
    client = Client(service.url, actor="[/bold][black]x")
    declare_lenient(client, "p", rules=[{"rule": "one_step_no_worse", "slack": 5.0}])
    client.close()
    assert "[/bold][black]x" in command(service, "audit").stdout


def test_a_job_that_could_not_be_closed_is_closed_later(told, tmp_path):
    _, folder, client, _ = told
    with sqlite3.connect(folder / "trueup.sqlite") as kept:
        kept.execute(
            "CREATE TRIGGER away BEFORE INSERT ON audit WHEN NEW.kind = 'job:finished' "
            "BEGIN SELECT RAISE(ABORT, 'away'); END"
        )
    kept.close()
    job = client.submit("p", {"kind": "fit", "method": "identify"})["id"]
    until(lambda: client.job(job)["stage"] == "packing")
    time.sleep(1.0)  # many times what closing a job takes
    assert client.job(job)["state"] == "running"
    with sqlite3.connect(folder / "trueup.sqlite") as kept:
        kept.execute("DROP TRIGGER away")
    kept.close()
    assert client.wait(job)["state"] == "succeeded"


def test_a_watch_goes_on_through_a_restart(tmp_path):
    service = Service(embedded(tmp_path / "data"))
    service.start_server()
    client = Client(service.url)
    client.register_plant(plant_document("p"))
    watching = Client(service.url)
    seen = watching.watch("p", wait_s=2.0)
    assert next(seen).generation == 1
    watcher = ThreadPoolExecutor(1)
    moved = watcher.submit(next, seen)
    time.sleep(0.2)  # so that it asks when the server goes
    service.stop()
    service.start_server(worker=True)
    for seed, role in ((0, Role.ADAPTATION), (1, Role.VALIDATION)):
        client.upload_episode("p", save(tmp_path, f"{seed}.mcap", episode_bytes(seed, role=role)))
    candidate = client.wait(client.submit("p", {"kind": "fit", "method": "identify"})["id"])[
        "result"
    ]["artifact"]
    gate = client.declare_gate("p", LENIENT)["digest"]
    decision = client.wait(
        client.submit("p", {"kind": "gate", "candidate": candidate, "gate": gate})["id"]
    )["result"]["decision"]
    assert not moved.done()
    client.promote("p", decision, 1)
    assert moved.result(timeout=30).generation == 2
    watcher.shutdown()
    seen.close()
    watching.close()
    client.close()
    service.stop()
