"""One suite over both storages: what the registry promises."""

import hashlib
import random
import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import fields, replace
from datetime import UTC, datetime, timedelta

import pytest
from sqlalchemy import event, func, select, text

from tests.support.made import plant_document
from trueup.canonical import digest_of
from trueup.errors import PointerMoved
from trueup.ledger.audit import rebuild
from trueup.ledger.pointer import NothingToRollBackTo
from trueup_migrations import HEAD
from trueup_service.actions.declare_gate import declare_gate
from trueup_service.actions.idempotency import IdempotencyKey, run_once_in
from trueup_service.actions.move_pointer import promote_decision, roll_back_pointer
from trueup_service.actions.record_decision import record_decision
from trueup_service.actions.register_plant import register_plant
from trueup_service.actor_context import ActorContext, time_text
from trueup_service.errors import Conflict, KeyReused, NotWhole
from trueup_service.registry.blobs import BlobMissing
from trueup_service.registry.records import ArtifactRecord, JobRecord, JobState
from trueup_service.registry.repository import Repository
from trueup_service.registry.schema import altered, current, migrate
from trueup_service.registry.tables import metadata
from trueup_service.registry.transaction import ReadTransaction, Transaction

CONTEXT = ActorContext("tester", "2026-01-01T00:00:00.000000Z")


@pytest.fixture
def plant(parts):
    with parts.database.write() as connection:
        register_plant(Transaction(connection), plant_document("p"), CONTEXT)
    return "p"


def read(parts):
    return parts.database.read()


def at(second: int) -> ActorContext:
    return ActorContext("tester", f"2026-01-01T00:00:{second:02d}.000000Z")


def add_version(tx: Transaction, plant: str, version: int) -> str:
    digest = hashlib.sha256(f"{plant}{version}".encode()).hexdigest()
    tx.artifacts.add(
        ArtifactRecord(
            plant, version, digest, "identified", "{}", None, None, CONTEXT.now, "tester"
        )
    )
    return digest


def test_a_stretch_of_time_is_found_though_clocks_differ_and_plants_are_mixed(parts, plant):
    """Halving the log finds what looking at every entry finds."""
    begin = datetime(2026, 1, 1, tzinfo=UTC)
    skew = random.Random(3)
    with parts.database.write() as connection:
        tx = Transaction(connection)
        for minute in range(300):
            at = begin + timedelta(minutes=minute + skew.uniform(-20.0, 20.0))
            context = ActorContext("tester", time_text(at))
            of = plant if minute % 3 else None
            tx.log.append(context, "note:made", plant=of, subject=str(minute), facts={})
    with read(parts) as connection:
        log = ReadTransaction(connection).log
        every = log.entries(0, 1000, plant=plant)
        for first, last in [(-60, 500), (40, 50), (100, 100.5), (290, 400), (-90, -60), (250, 260)]:
            since, until = (time_text(begin + timedelta(minutes=m)) for m in (first, last))
            wanted = [e for e in reversed(every) if since <= e.at <= until]
            assert log.entries_between(plant, since, until, 1000) == wanted
            assert log.entries_between(plant, since, until, 3) == wanted[:3]


def decide(tx: Transaction, plant: str, candidate: str) -> str:
    """An accepted decision against what serves."""
    serving = tx.serving.now(plant)
    gate, _ = declare_gate(tx, plant, None, CONTEXT)
    against = {"incumbent": serving.artifact, "generation": serving.generation}
    document = {
        "gate": gate.digest,
        "candidate": candidate,
        "accepted": True,
        "episodes": [],
        **against,
    }
    record_decision(tx, plant, document, None, CONTEXT)
    return digest_of(document)


def promote(parts, plant, version, second):
    with parts.database.write() as connection:
        tx = Transaction(connection)
        decision = decide(tx, plant, add_version(tx, plant, version))
        return promote_decision(
            tx, plant, decision, tx.serving.now(plant).generation, {}, at(second)
        )


def test_a_fresh_database_is_at_the_head_and_migrating_again_changes_nothing(parts):
    assert current(parts.database) == HEAD
    with parts.database.write() as connection:
        register_plant(Transaction(connection), plant_document("p"), CONTEXT)
    before = rows(parts)
    assert before["plants"] == 1
    migrate(parts.database)
    assert (current(parts.database), rows(parts)) == (HEAD, before)
    assert list(altered(parts.database)) == []


def rows(parts):
    """How many rows each table has."""
    with read(parts) as connection:
        return {
            name: connection.scalar(select(func.count()).select_from(table))
            for name, table in metadata.tables.items()
        }


def test_a_database_that_says_another_schema_than_it_has_is_refused_in_words(parts):
    with parts.database.write() as connection:
        connection.execute(text("UPDATE alembic_version SET version_num = '0007'"))
    with pytest.raises(
        NotWhole, match="says that its schema is 0007, and cannot be brought from there"
    ):
        migrate(parts.database)


def test_registering_makes_the_nominal_model_serve_at_generation_1(parts, plant):
    with read(parts) as connection:
        serving = ReadTransaction(connection).serving.now(plant)
        assert (serving.generation, serving.version, serving.kind, serving.decision) == (
            1,
            1,
            "registered",
            None,
        )
        assert ReadTransaction(connection).artifacts.get(plant, serving.artifact).kind == "nominal"


def test_registering_the_same_again_is_no_change_and_another_is_a_conflict(parts, plant):
    with parts.database.write() as connection:
        assert register_plant(Transaction(connection), plant_document("p"), CONTEXT)[1] is False
    other = plant_document("p") | {"evaluation": {"horizon_s": 3.0}}
    with pytest.raises(Conflict), parts.database.write() as connection:
        register_plant(Transaction(connection), other, CONTEXT)
    with read(parts) as connection:
        assert ReadTransaction(connection).log.tree().size == 1


@pytest.mark.parametrize("kind", Repository.__subclasses__(), ids=lambda kind: kind.__name__)
def test_the_fields_of_a_record_are_the_columns_of_its_table(kind):
    assert {f.name for f in fields(kind.record)} == {c.name for c in kind.table.columns}


def test_a_transaction_that_reads_refuses_to_write(parts, plant):
    with read(parts) as connection:
        tx = ReadTransaction(connection)
        with pytest.raises(TypeError, match="only reads"):
            tx.plants.add(tx.plants.get(plant))


def test_an_error_leaves_nothing_behind(parts):
    with pytest.raises(RuntimeError), parts.database.write() as connection:
        register_plant(Transaction(connection), plant_document("p"), CONTEXT)
        raise RuntimeError
    with read(parts) as connection:
        tx = ReadTransaction(connection)
        assert (tx.plants.get("p"), tx.serving.now("p"), tx.log.tree().size) == (None, None, 0)


def test_the_pointer_goes_forward_and_back_like_a_stack(parts, plant):
    first = promote(parts, plant, 2, 1)
    second = promote(parts, plant, 3, 2)
    assert (first.generation, second.generation) == (2, 3)
    versions = []
    for generation in (3, 4):
        with parts.database.write() as connection:
            versions.append(
                roll_back_pointer(
                    Transaction(connection), plant, generation, None, {}, at(generation)
                ).version
            )
    assert versions == [2, 1]
    with pytest.raises(NothingToRollBackTo), parts.database.write() as connection:
        roll_back_pointer(Transaction(connection), plant, 5, None, {}, at(9))
    with read(parts) as connection:
        assert [m.version for m in ReadTransaction(connection).serving.history(plant, 0, 99)] == [
            1,
            2,
            3,
            2,
            1,
        ]


def test_history_says_what_was_live_at_a_time(parts, plant):
    promote(parts, plant, 2, 10)
    promote(parts, plant, 3, 20)
    with read(parts) as connection:
        tx = ReadTransaction(connection)
        live = {
            second: tx.serving.at_time(plant, at(second).now).version
            for second in (0, 9, 10, 19, 20, 59)
        }
        assert live == {0: 1, 9: 1, 10: 2, 19: 2, 20: 3, 59: 3}
        assert tx.serving.at_time(plant, "2025-12-31T23:59:59.999999Z") is None


def test_a_move_is_never_before_the_one_it_follows_whatever_the_clock_does(parts, plant):
    promote(parts, plant, 2, 30)
    assert promote(parts, plant, 3, 5).at == at(30).now


def test_of_many_racing_promotions_one_wins(parts, plant):
    with parts.database.write() as connection:
        tx = Transaction(connection)
        decision = decide(tx, plant, add_version(tx, plant, 2))
    gate = threading.Barrier(8)

    def race(_):
        gate.wait()
        try:
            with parts.database.write() as connection:
                return promote_decision(
                    Transaction(connection), plant, decision, 1, {}, CONTEXT
                ).generation
        except PointerMoved:
            return None

    with ThreadPoolExecutor(8) as pool:
        outcomes = list(pool.map(race, range(8)))
    assert sorted(outcomes, key=str) == [2, *[None] * 7]
    with read(parts) as connection:
        assert (
            len(
                [
                    e
                    for e in ReadTransaction(connection).log.entries(0, 99)
                    if e.kind == "pointer:moved"
                ]
            )
            == 1
        )


def test_the_audit_tree_holds_under_concurrent_writers(parts):
    def write(n):
        with parts.database.write() as connection:
            Transaction(connection).log.append(
                ActorContext(f"a{n}", CONTEXT.now),
                "thing:done",
                plant=None,
                subject=str(n),
                facts={"n": n},
            )

    with ThreadPoolExecutor(8) as pool:
        list(pool.map(write, range(40)))
    with read(parts) as connection:
        tx = ReadTransaction(connection)
        entries = tx.log.entries(0, 99)
        assert rebuild(entries) == tx.log.tree()
    assert sorted(int(e.subject) for e in entries) == list(range(40))


def test_an_audit_entry_is_bound_to_its_transaction(parts):
    with pytest.raises(RuntimeError), parts.database.write() as connection:
        Transaction(connection).log.append(
            ActorContext("a", CONTEXT.now), "thing:done", plant=None, subject="s", facts={}
        )
        raise RuntimeError
    with read(parts) as connection:
        assert ReadTransaction(connection).log.entries(0, 9) == []


def test_an_idempotency_key_repeats_its_answer_and_refuses_another_request(parts):
    calls = []

    def act():
        calls.append(1)
        return {"n": len(calls)}

    def send(request):
        with parts.database.write() as connection:
            return run_once_in(
                Transaction(connection), IdempotencyKey("s", "k", request), CONTEXT.now, act
            )

    assert send("a" * 64) == send("a" * 64) == {"n": 1}
    with pytest.raises(KeyReused):
        send("b" * 64)
    assert len(calls) == 1


def test_a_finished_job_never_changes(parts, plant):
    job = JobRecord(
        "0" * 32,
        plant,
        "fit",
        {},
        JobState.QUEUED,
        0.0,
        "queued",
        None,
        CONTEXT.now,
        "t",
        CONTEXT.now,
    )
    with parts.database.write() as connection:
        tx = Transaction(connection)
        tx.jobs.add(job)
        assert tx.jobs.update(job.id, now=CONTEXT.now, state=JobState.SUCCEEDED, result={"a": 1})
        assert not tx.jobs.update(job.id, now=CONTEXT.now, state=JobState.RUNNING, progress=0.1)
        assert tx.jobs.get(job.id) == replace(job, state="succeeded", result={"a": 1})


def test_reads_of_a_job_are_noted_once(parts, plant):
    job = JobRecord(
        "0" * 32,
        plant,
        "fit",
        {},
        JobState.QUEUED,
        0.0,
        "queued",
        None,
        CONTEXT.now,
        "t",
        CONTEXT.now,
    )
    with parts.database.write() as connection:
        tx = Transaction(connection)
        tx.jobs.add(job)
        tx.jobs.add_reads(job.id, ["a" * 64, "b" * 64], "fit")
        tx.jobs.add_reads(job.id, ["b" * 64], "fit")
        assert tx.jobs.reads(job.id) == {"a" * 64: "fit", "b" * 64: "fit"}
        assert (tx.jobs.count_uses("b" * 64, "fit"), tx.jobs.count_uses("b" * 64, "gate")) == (1, 0)


def test_the_serving_pointer_alone_reads_no_other_version(parts, plant):
    """What is asked for GET serving finds its rows by their keys, and looks through no table."""
    asked = []

    def note(_connection, _cursor, statement, values, *_):
        if statement.startswith("SELECT"):
            asked.append((statement, values))

    with read(parts) as connection:
        event.listen(connection, "before_cursor_execute", note)
        assert ReadTransaction(connection).serving.now(plant).generation == 1
        event.remove(connection, "before_cursor_execute", note)
        assert asked
        explain = "EXPLAIN QUERY PLAN" if parts.database.is_sqlite else "EXPLAIN"
        if not parts.database.is_sqlite:  # which looks through a table of two rows, if it may
            connection.exec_driver_sql("SET LOCAL enable_seqscan = off")
        for statement, values in asked:
            plan = [
                str(row[-1]) for row in connection.exec_driver_sql(f"{explain} {statement}", values)
            ]
            assert any("USING INDEX" in line or "Index" in line for line in plan), plan
            assert not any(line.startswith("SCAN") or "Seq Scan" in line for line in plan), plan


class TestBlobs:
    def put(self, parts, data: bytes) -> str:
        digest = hashlib.sha256(data).hexdigest()
        path = parts.spool / digest
        path.write_bytes(data)
        parts.blobs.put(digest, path)
        path.unlink()
        return digest

    def test_bytes_come_back_whole_and_in_parts(self, parts):
        data = bytes(range(256)) * 20_000
        digest = self.put(parts, data)
        assert parts.blobs.get(digest) == data
        assert b"".join(parts.blobs.stream(digest)) == data
        assert parts.blobs.holds(digest)

    def test_putting_again_changes_nothing(self, parts):
        assert self.put(parts, b"first") == self.put(parts, b"first")
        assert parts.blobs.get(self.put(parts, b"first")) == b"first"

    @pytest.mark.parametrize("name", ["0" * 64, "../../etc/passwd", "A" * 64, ""])
    def test_what_is_not_there_is_missing(self, parts, name):
        with pytest.raises(BlobMissing):
            parts.blobs.get(name)
        with pytest.raises(BlobMissing):
            next(parts.blobs.stream(name))

    def test_racing_puts_of_one_blob_all_succeed(self, parts):
        data = b"x" * 100_000
        digest = hashlib.sha256(data).hexdigest()

        def put(n):
            path = parts.spool / f"{n}"
            path.write_bytes(data)
            parts.blobs.put(digest, path)

        with ThreadPoolExecutor(8) as pool:
            list(pool.map(put, range(16)))
        assert parts.blobs.get(digest) == data


def test_documents_are_canonical_text_whose_digest_is_the_plants(parts, plant):
    with read(parts) as connection:
        kept = connection.scalar(text("SELECT document FROM plants"))
        assert (
            hashlib.sha256(kept.encode()).hexdigest()
            == ReadTransaction(connection).plants.get(plant).digest
        )


def test_a_registry_from_before_the_tree_is_migrated_and_holds(storage):
    from trueup.ledger.verification import verify
    from trueup_migrations import upgrade
    from trueup_service.installation import Installation
    from trueup_service.registry.database import Database

    settings = storage.settings()
    settings.data_dir.mkdir(parents=True)
    old = Database(settings.sqlalchemy_url, 2)
    with old.write() as connection:
        upgrade(connection, "0002")
        when = {"at": CONTEXT.now, "by": "tester", "d": digest_of({}), "doc": "{}"}
        connection.execute(text("INSERT INTO plants VALUES ('p', :d, :doc, :at, :by)"), when)
        connection.execute(
            text(
                "INSERT INTO audit VALUES (1, :at, 'plant:registered', :by, 'p', 's', :doc, "
                "'d', 'd')"
            ),
            when,
        )
        connection.execute(text("UPDATE audit_head SET sequence = 1"))
    old.close()
    parts = storage.build()
    found = verify(Installation(parts.database, parts.blobs))
    assert (found.findings, found.size, found.rows) == ([], 2, 1)
    parts.close()
