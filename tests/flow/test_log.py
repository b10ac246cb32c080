"""The log as others see it: proofs, witnesses, robots, provenance; and whatever is changed behind
its back."""

import base64
import json
import os
import random
import re
import shutil
import struct
import subprocess
import sys
import urllib.error
import urllib.request
from contextlib import closing
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from sqlalchemy import text

from tests.http.test_http import move
from tests.support.forks import run
from tests.support.gates import LENIENT, declare_lenient
from tests.support.made import plant_document
from tests.support.service import ADMIN, ROOT, Service, command
from tests.support.storage import embedded
from tests.support.tampering import cut, flip, promoted
from trueup.ledger.signed_note import Signer
from trueup.ledger.verification import verify
from trueup_client import Client, LogForked, NotSigned, Problem, Robot, Witness
from trueup_client.proof import Checkpoint, Key, includes, leaf_hash
from trueup_service.archives import export
from trueup_service.errors import LogRewound, OtherKey
from trueup_service.installation import Installation, lost_jobs, published, signing, unnamed_blobs
from trueup_service.registry.transaction import ReadTransaction
from trueup_service.settings import Settings
from trueup_service.signed_log import open_log
from trueup_service.wiring import build


def get(service, path):
    asked = urllib.request.Request(
        f"{service.url}/v1/audit/{path}", headers={"Authorization": f"Bearer {ADMIN}"}
    )
    with urllib.request.urlopen(asked) as answer:
        return answer.read()


@pytest.fixture(scope="module")
def told(tmp_path_factory):
    """A service with a plant that has two versions, a decision and a moved pointer; its folder, and
    a client."""
    folder = tmp_path_factory.mktemp("log")
    service = Service(embedded(folder / "data"), serving_lease_s=60)
    with service.running():
        client = Client(service.url)
        yield service, folder, client, *promoted(client, folder)
        client.close()


@pytest.fixture
def log(told):
    client = told[2]
    return client, Key.from_text(client.audit_key())


# -- proofs


def test_every_entry_is_proven_to_be_in_the_log_by_its_tile(told, log):
    client, key = log
    seen = Checkpoint.of(client.checkpoint(), key)
    bundle, leaves = get(told[0], f"tile/entries/000.p/{seen.size}"), []
    while bundle:
        (length,) = struct.unpack(">H", bundle[:2])
        leaves.append(bundle[2 : 2 + length])
        bundle = bundle[2 + length :]
    assert len(leaves) == seen.size
    for position, leaf in enumerate(leaves):
        assert json.loads(leaf)["sequence"] == position + 1
        assert includes(
            seen.root,
            seen.size,
            position,
            leaf_hash(leaf),
            client.inclusion(position + 1, seen.size),
        )
    hashes = get(told[0], f"tile/0/000.p/{seen.size}")
    assert hashes == b"".join(leaf_hash(leaf) for leaf in leaves)


@pytest.mark.parametrize(
    "path",
    [
        "tile/0/000",
        "tile/0/x001/000",
        "tile/0/000.p/255",
        "tile/entries/000",
        "tile/1/000.p/1",
        "rows/secrets",
    ],
)
def test_what_the_log_has_not_is_not_there(told, path):
    with pytest.raises(urllib.error.HTTPError) as refused:
        get(told[0], path)
    refused.value.close()
    assert refused.value.code == 404


@pytest.mark.parametrize(
    ("path", "status"),
    [
        ("tile/0/1", 422),
        ("tile/9/000", 422),
        ("inclusion?sequence=9999", 400),
        ("consistency?old=5&size=9999", 400),
        ("rows/plants?after=x", 400),
    ],
)
def test_what_is_no_question_is_refused(told, path, status):
    with pytest.raises(urllib.error.HTTPError) as refused:
        get(told[0], path)
    refused.value.close()
    assert refused.value.code == status


# -- witnesses


def test_a_witness_sees_the_log_grow_and_refuses_one_that_was_rewritten(told, log, tmp_path):
    client, _ = log
    witness = Witness(tmp_path / "seen.json")
    first = client.witness(witness)
    rules = [{"rule": "one_step_no_worse", "slack": 3.0}]
    declare_lenient(client, "p", rules=rules)
    second = client.witness(Witness(tmp_path / "seen.json"))
    assert second.size == first.size + 1
    for size, root in (
        (second.size, bytes(32)),
        (second.size + 1, bytes(32)),
    ):  # whoever has the key tells another story
        with pytest.raises(LogForked):
            Witness(tmp_path / "seen.json").see(
                signer(told).checkpoint(size, root), client.consistency
            )
    forged = Witness(tmp_path / "seen.json")
    with pytest.raises(LogForked):
        forged.see(signer(told).checkpoint(second.size + 1, bytes(32)), lambda *_: [bytes(32)] * 4)
    assert client.witness(Witness(tmp_path / "seen.json")).size == second.size


def signer(told):
    return Signer.from_text((told[1] / "data" / "signing.key").read_text())


def test_a_witness_refuses_a_log_whose_tail_was_cut(told, log, tmp_path):
    client, key = log
    seen = Checkpoint.of(client.checkpoint(), key)
    witness = Witness(tmp_path / "seen.json", client.audit_key())
    witness.see(signer(told).checkpoint(seen.size + 5, bytes(32)), client.consistency)
    with pytest.raises(LogForked):
        client.witness(witness)


def test_a_witness_refuses_another_key(told, log, tmp_path):
    client, _ = log
    client.witness(Witness(tmp_path / "seen.json"))
    with pytest.raises(NotSigned):
        Witness(tmp_path / "seen.json").pin("other+" + client.audit_key().split("+", 1)[1])
    other = Witness(tmp_path / "given.json", GOLDEN_KEY)
    with pytest.raises(NotSigned):
        client.witness(other)


GOLDEN_KEY = json.loads(
    (Path(__file__).parents[1] / "golden" / "tlog" / "vectors.json").read_text()
)["verifier"]


def test_the_command_refuses_a_service_whose_log_it_has_seen_otherwise(told, tmp_path):
    service = told[0]
    assert command(service, "audit", "checkpoint").returncode == 0
    state = next((told[1] / "data" / "trueup" / "seen").iterdir())
    kept = state.read_text()
    state.write_text(
        json.dumps(json.loads(kept) | {"checkpoint": signer(told).checkpoint(9999, bytes(32))})
    )
    done = command(service, "fetch", "p", str(tmp_path / "model"), check=False)
    assert (done.returncode, "rewritten" in done.stderr) == (4, True)
    state.write_text(kept)


# -- robots


def test_a_robot_has_the_last_good_model_at_once_and_goes_on_without_the_service(told, tmp_path):
    service, _, client, candidate, _ = told
    robot = Robot(service.url, "p", tmp_path / "robot", client.audit_key())
    assert robot.current() is None
    model = robot.refresh()
    assert (model.answer.artifact, model.answer.generation) == (
        candidate,
        client.serving("p").generation,
    )
    assert (model.folder / "manifest.json").is_file()
    assert robot.is_current()
    assert robot.fallback() is not None
    away = Robot("http://127.0.0.1:9", "p", tmp_path / "robot")
    assert away.current() == model
    away.start(interval_s=60)
    away.stop()
    late = Robot(
        "http://127.0.0.1:9",
        "p",
        tmp_path / "robot",
        clock=lambda: datetime.now(UTC) + timedelta(hours=2),
    )
    assert (late.current(), late.is_current()) == (model, False)


def test_a_robot_refuses_an_older_generation_a_forged_answer_and_one_for_another_plant(
    told, tmp_path, monkeypatch
):
    service, _, client, _, _ = told
    robot = Robot(service.url, "p", tmp_path / "robot")
    old = client.serving_envelope("p")

    def refused(envelope, error, why):
        """What a robot says that is answered with an envelope of somebody else's."""
        with monkeypatch.context() as service_of_another:
            service_of_another.setattr(Client, "serving_envelope", lambda *_: envelope)
            with pytest.raises(error, match=why):
                robot.refresh()
        assert robot.current().answer.generation == moved.generation

    robot.refresh()
    moved = move(client, "p", 1.3, LENIENT)
    assert robot.refresh().answer.generation == moved.generation
    refused(old, LogForked, "was answered after generation")
    payload = json.loads(base64.b64decode(old["payload"]))
    forged = base64.b64encode(json.dumps(payload | {"generation": 99}).encode()).decode()
    refused(old | {"payload": forged}, NotSigned, "sign")
    client.register_plant(plant_document("q"))
    refused(client.serving_envelope("q"), NotSigned, "not for plant 'p'")
    assert robot.refresh().answer.generation == moved.generation


def test_a_robot_whose_kept_answer_was_changed_has_none(told, tmp_path):
    service, _, client, _, _ = told
    Robot(service.url, "p", tmp_path / "robot", client.audit_key()).refresh()
    kept = tmp_path / "robot" / "serving.json"
    kept.write_text(kept.read_text().replace('"sig": "', '"sig": "A'))
    assert Robot("http://127.0.0.1:9", "p", tmp_path / "robot").current() is None


# -- a key that takes over


def test_a_key_takes_over_and_whoever_pinned_the_one_before_follows_by_its_word_alone(tmp_path):
    service, folder = Service(embedded(tmp_path / "data")), tmp_path / "data"
    with service.running(worker=False):
        with closing(Client(service.url)) as client:
            client.register_plant(plant_document("p"))
            first = client.audit_key()
            for name in ("robot", "cut off"):
                Robot(service.url, "p", tmp_path / name, first).refresh()
            client.witness(Witness(tmp_path / "seen.json", first))
            before = Checkpoint.of(client.checkpoint(), Key.from_text(first))
        service.stop()
        (folder / "signing.key").rename(folder / "signing.key.before")
        service.start_server()
        with closing(Client(service.url)) as client:
            then = client.audit_key()
            (folder / "signing.key.before").unlink()
            assert then != first
            assert client.witness(Witness(tmp_path / "seen.json", first)).size == before.size + 1
            # as a script names it that has not been told
            again = Witness(tmp_path / "seen.json", first)
            assert [key.text for key in again.keys] == [first, then]
            assert again.last.size == before.size + 1
            told_by_hand = Witness(tmp_path / "told.json", first)
            told_by_hand.see(before.note, client.consistency)
            assert [key.text for key in Witness(tmp_path / "told.json", then).keys] == [first, then]
            assert client.witness(Witness(tmp_path / "told.json", then)).size == before.size + 1
            for seen in ("other.json", "told.json"):
                with pytest.raises(NotSigned):
                    client.witness(Witness(tmp_path / seen, GOLDEN_KEY))
            cut_off = Robot("http://127.0.0.1:9", "p", tmp_path / "cut off", first)
            cut_off._witness.keys = again.keys  # it stopped between the new key and the new answer
            assert cut_off._stored_model() is not None
            robot = Robot(service.url, "p", tmp_path / "robot", first)
            kept = (tmp_path / "robot" / "serving.json").read_text()
            assert robot.refresh().answer.generation == 1
            assert (tmp_path / "robot" / "serving.json").read_text() != kept
            assert Robot("http://127.0.0.1:9", "p", tmp_path / "robot", first).current() is not None
            (entry,) = (e for e in client.audit() if e["kind"] == "key:replaced")
            assert (entry["subject"], entry["facts"]["before"]) == (then, first)
        assert command(service, "audit", "verify").returncode == 0
    parts = build(Settings(data_dir=folder))
    export(
        parts,
        open_log(parts.settings, parts.database),
        tmp_path / "p.tar",
        "p",
        "2026-01-01T00:00:00.000000Z",
        lambda *_: None,
    )
    parts.close()
    verifier = [
        sys.executable,
        str(Path(__file__).parents[2] / "tools" / "verify_archive.py"),
        str(tmp_path / "p.tar"),
    ]
    for key, expected in ((first, 0), (then, 0), (GOLDEN_KEY, 4)):
        done = subprocess.run([*verifier, key], capture_output=True, text=True, check=False)
        assert done.returncode == expected, done.stdout


def test_a_key_takes_over_only_from_the_one_that_signs_and_for_the_same_log(tmp_path):
    def opened(key, before=None):
        log = open_log(
            Settings(
                data_dir=tmp_path, signing_key=key.text, signing_key_before=before and before.text
            ),
            parts.database,
        )
        return log.signer.verifier

    first, second, third = (Signer("log.example", bytes([n]) * 32) for n in range(3))
    parts = build(Settings(data_dir=tmp_path))
    opened(first)
    for key, before in (
        (second, None),
        (second, third),
        (second, second),
        (Signer("another.example", bytes(32)), first),
    ):
        with pytest.raises(OtherKey):
            opened(key, before)
    assert opened(second, first) == opened(second) == second.verifier
    with pytest.raises(OtherKey):
        opened(first, second)  # what was taken out of use stays out
    assert opened(third, second) == third.verifier
    with parts.database.read() as connection:
        keys = ReadTransaction(connection).log.signing_keys()
    parts.close()
    notes = [key.endorsement for key in keys if key.endorsement]
    pinned = Key.from_text(first.verifier)
    assert [key.text for key in pinned.followed(notes)] == [second.verifier, third.verifier]
    assert pinned.followed(reversed(notes)) == pinned.followed(notes[:1])
    stolen = Signer("log.example", bytes([9]) * 32)
    for note in (
        stolen.endorsement(stolen.verifier),
        first.note(f"another line\n{stolen.verifier}\n"),
        first.checkpoint(3, bytes(32)),
        "",
    ):
        assert pinned.followed([note]) == []


# -- provenance


def test_provenance_names_everything_by_digest_and_is_signed(told, log):
    client, key = log
    _, _, _, candidate, decision = told
    statement = key.payload(
        client.artifact_provenance("p", candidate), "application/vnd.in-toto+json"
    )
    assert statement["_type"] == "https://in-toto.io/Statement/v1"
    assert statement["subject"][0]["digest"]["sha256"] == candidate
    named = {
        d["uri"].split(":")[2]
        for d in statement["predicate"]["buildDefinition"]["resolvedDependencies"]
    }
    assert named == {"plant", "episode", "artifact", "configuration"}
    assert set(statement["predicate"]["runDetails"]["builder"]["version"]) == {"version", "sha256"}
    tested = key.payload(client.decision_provenance("p", decision), "application/vnd.in-toto+json")
    assert tested["predicate"]["result"] == "PASSED"
    assert tested["subject"][0]["digest"]["sha256"] == candidate
    assert {c["uri"].split(":")[2] for c in tested["predicate"]["configuration"]} == {
        "gate",
        "artifact",
        "episode",
        "decision",
    }
    said = command(told[0], "audit", "provenance", "p", decision)
    assert json.loads(said.stdout) == tested


# -- tampering


@pytest.fixture
def kept(told):
    parts = build(told[0].storage.settings())
    yield parts
    parts.close()


def found(parts):
    return verify(Installation(parts.database, parts.blobs, signing(parts))).findings or published(
        parts
    )


def test_what_was_not_touched_holds(kept, told):
    assert found(kept) == []
    assert lost_jobs(kept) == []
    assert unnamed_blobs(kept) == []
    assert "whole" in run_fsck(told).stdout


def run_fsck(told):
    return run(
        "trueup_cli.main",
        ["fsck"],
        {**os.environ, **told[0].storage.environment, "COLUMNS": "200"},
        ROOT,
    )


# every kind of row that this plant has, the log, and bytes
FLIPPED = {
    "plants", "episodes", "artifacts", "gates", "decisions", "moves", "serving",
    "jobs", "audit", "audit_tree", "audit_head", "blob",
}  # fmt: skip


def test_any_flipped_byte_is_found(kept):
    rng = random.Random(7)
    missed, touched, count = [], set(), 0
    while count < 60 or not touched >= FLIPPED:
        flipped, count = flip(kept, rng), count + 1
        touched.add(re.split(r"[ .]", flipped.where)[0])
        if not found(kept):
            missed.append(flipped.where)
        flipped.undo()
        assert count < 500, FLIPPED - touched
    assert missed == []
    assert found(kept) == []


def test_a_server_signs_no_head_that_its_tree_does_not_have(kept, told):
    with kept.database.engine.connect() as connection:
        head = connection.execute(text("SELECT frontier FROM audit_head")).scalar()
        connection.execute(text("UPDATE audit_head SET frontier = :f"), {"f": bytes(len(head))})
        connection.commit()
    try:
        with pytest.raises(Problem) as refused:
            told[2].checkpoint()
        assert refused.value.code == "log-rewound"
    finally:
        with kept.database.engine.connect() as connection:
            connection.execute(text("UPDATE audit_head SET frontier = :f"), {"f": head})
            connection.commit()


def test_every_cut_tail_is_found_however_well_it_is_cut(kept, tmp_path):
    """Entries, tree and head are cut alike, so that what is left is a sound log; only the published
    head shows it."""
    open_log(kept.settings, kept.database).publish()
    entries = list(Installation(kept.database, kept.blobs).entries(0, 10**6))
    shutil.copytree(kept.settings.data_dir, tmp_path / "copy")
    copy = build(embedded(tmp_path / "copy").settings())
    for size in reversed(range(len(entries))):
        cut(copy, entries, size)
        assert [f.where for f in published(copy)] == ["log"]
        assert not [
            f
            for f in verify(Installation(copy.database, copy.blobs)).findings
            if f.where in ("log", "tree")
        ]
    copy.close()


def test_a_move_that_no_entry_explains_is_found(kept, told):
    plant = "p"
    with kept.database.engine.connect() as connection:
        before = connection.execute(
            text("SELECT generation FROM serving WHERE plant = 'p'")
        ).scalar()
        connection.execute(text("UPDATE serving SET generation = 1 WHERE plant = 'p'"))
        connection.commit()
    try:
        assert [f.where for f in found(kept)] == [f"serving/{plant}"]
        assert run_fsck(told).returncode == 4
    finally:
        with kept.database.engine.connect() as connection:
            connection.execute(
                text("UPDATE serving SET generation = :g WHERE plant = 'p'"), {"g": before}
            )
            connection.commit()


def test_a_server_signs_no_log_shorter_than_the_one_it_published(tmp_path):
    parts = build(Settings(data_dir=tmp_path))
    log = open_log(parts.settings, parts.database)
    (tmp_path / "checkpoint").write_text(log.signer.checkpoint(3, bytes(32)))
    with pytest.raises(LogRewound):
        open_log(parts.settings, parts.database).checkpoint()
    (tmp_path / "signing.key").unlink()
    with pytest.raises(OtherKey):
        open_log(parts.settings, parts.database)
    parts.close()


def test_a_number_that_is_written_like_an_integer_stays_verifiable(told, kept):
    rules = [{"rule": "one_step_no_worse", "slack": 1e17}]
    declare_lenient(told[2], "p", rules=rules)
    assert found(kept) == []


def test_an_entry_kept_behind_the_end_of_the_log_is_found_and_not_shown(told, kept):
    with kept.database.write() as connection:
        columns = 'sequence, at, kind, actor, plant, subject, facts, "rows"'
        copy = (
            f"INSERT INTO audit ({columns}) SELECT 1000000, at, kind, actor, plant, subject, "
            "facts, '{}' FROM audit WHERE sequence = 1"
        )
        connection.execute(text(copy))
    try:
        assert [f.where for f in published(kept)] == ["log"]
        assert max(e["sequence"] for e in told[2].audit()) < 1000000
    finally:
        with kept.database.write() as connection:
            connection.execute(text("DELETE FROM audit WHERE sequence = 1000000"))


FORGED = Signer("trueup-forged", b"f" * 32)
BESIDE_THE_LOG = {
    "the key is another": "UPDATE audit_key SET verifier = :forged",
    "the key is gone": "DELETE FROM audit_key",
    "a key too many": "INSERT INTO audit_key (id, verifier, endorsement) VALUES (2, :forged, NULL)",
    "an endorsement that nobody gave": "UPDATE audit_key SET endorsement = 'x'",
    "a hash of no entries": "INSERT INTO audit_tree (node, hash) VALUES (281474976710000, :hash)",
    "a hash of no level": "INSERT INTO audit_tree (node, hash) VALUES (-7, :hash)",
    "a second head": "INSERT INTO audit_head (id, size, frontier) VALUES (2, 0, :hash)",
}


@pytest.mark.parametrize("edit", BESIDE_THE_LOG.values(), ids=BESIDE_THE_LOG.keys())
def test_what_is_edited_beside_the_entries_is_found_by_fsck_and_by_verify(told, kept, edit):
    parts = told[0].storage.build()
    values = {
        name: value
        for name, value in (("forged", FORGED.verifier), ("hash", b"h" * 32))
        if f":{name}" in edit
    }
    tables = ("audit_key", "audit_tree", "audit_head")
    before = {}
    with parts.database.write() as connection:
        for table in tables:
            before[table] = connection.execute(text(f"SELECT * FROM {table}")).mappings().all()
        connection.execute(text(edit), values)
    try:
        assert found(kept) != []
        assert run_fsck(told).returncode == 4
        done = command(told[0], "audit", "verify", "--no-replay", check=False)
        assert (done.returncode, "audit_" in done.stdout or "tree/" in done.stdout) == (4, True), (
            done.stderr
        )
    finally:
        with parts.database.write() as connection:
            for table, rows in before.items():
                connection.execute(text(f"DELETE FROM {table}"))
                for row in rows:
                    names = ", ".join(row)
                    connection.execute(
                        text(
                            f"INSERT INTO {table} ({names}) VALUES "
                            f"({', '.join(f':{n}' for n in row)})"
                        ),
                        dict(row),
                    )
        parts.close()
    assert found(kept) == []
    assert command(told[0], "audit", "verify", "--no-replay").returncode == 0


def test_a_published_head_that_none_of_the_kept_keys_signed_is_found_without_the_key(told, kept):
    with kept.database.write() as connection:
        before = connection.execute(text("SELECT verifier FROM audit_key")).scalar()
        connection.execute(
            text("UPDATE audit_key SET verifier = :forged"), {"forged": FORGED.verifier}
        )
    try:
        assert verify(Installation(kept.database, kept.blobs)).findings == []  # nobody can say
        assert [f.where for f in published(kept)] == ["audit_key"]
    finally:
        with kept.database.write() as connection:
            connection.execute(text("UPDATE audit_key SET verifier = :v"), {"v": before})


def test_a_robot_keeps_the_highest_generation_that_it_saw_though_it_could_not_fetch_it(
    told, tmp_path, monkeypatch
):
    service, _, client, _, _ = told
    robot = Robot(service.url, "p", tmp_path / "robot", client.audit_key())
    old, before = client.serving_envelope("p"), robot.refresh()
    move(client, "p", 1.4, LENIENT)
    monkeypatch.setattr(
        Robot, "_fetch", lambda *_: (_ for _ in ()).throw(OSError("the download was blocked"))
    )
    with pytest.raises(OSError, match="blocked"):
        robot.refresh()
    assert robot.current() == before
    again = Robot(service.url, "p", tmp_path / "robot")
    with pytest.raises(LogForked):
        again._require_later(again._opened(old, again._witness.key)[0])
    late = Robot(
        service.url, "p", tmp_path / "other", clock=lambda: datetime.now(UTC) + timedelta(days=2)
    )
    late._witness.pin(client.audit_key())
    with pytest.raises(NotSigned):
        late._require_later(late._opened(old, late._witness.key)[0])


def test_a_robot_does_not_take_a_damaged_model_for_whole(told, tmp_path):
    service, _, client, _, _ = told
    model = Robot(service.url, "p", tmp_path / "robot", client.audit_key()).refresh()
    (model.folder / "manifest.json").write_bytes(b"")
    again = Robot(service.url, "p", tmp_path / "robot")
    assert again.current() is None
    assert again.refresh().folder == model.folder
    assert (model.folder / "manifest.json").stat().st_size > 0
