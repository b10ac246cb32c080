"""What somebody with the database or the disk may have put there, found without the log being
told."""

import os
import random

import pytest
from sqlalchemy import text

from tests.support.made import plant_document
from tests.support.tampering import flip_row
from trueup.ledger.rows import KEYS
from trueup.ledger.verification import verify
from trueup_service.actions.register_plant import register_plant
from trueup_service.actions.tokens import issue_token
from trueup_service.actor_context import ActorContext
from trueup_service.installation import Installation
from trueup_service.registry import tables as t
from trueup_service.registry.blobs import BlobMissing
from trueup_service.registry.records import TokenRecord
from trueup_service.registry.schema import altered
from trueup_service.registry.transaction import Transaction, writing
from trueup_service.wiring import keep_bytes

CONTEXT = ActorContext("tester", "2026-01-01T00:00:00.000000Z")


@pytest.fixture
def parts(storage):
    found = storage.build()
    with found.database.write() as connection:
        register_plant(Transaction(connection), plant_document("p"), CONTEXT)
    yield found
    found.close()


def edit(parts, *statements):
    with parts.database.write() as connection:
        for statement in statements:
            connection.execute(text(statement))


def findings(parts):
    return [(f.where, f.what) for f in verify(Installation(parts.database, parts.blobs)).findings]


def schema(parts):
    return [(f.where, f.what) for f in altered(parts.database)]


def test_what_was_made_here_is_as_it_was_made(parts):
    assert findings(parts) == schema(parts) == []


def test_any_value_that_was_changed_in_a_row_is_found(parts):
    rng, missed = random.Random(7), []
    for _ in range(30):
        flipped = flip_row(parts, rng)
        if not findings(parts):
            missed.append(flipped.where)
        flipped.undo()
    assert missed == findings(parts) == []


def test_a_second_row_of_one_name_is_found(parts):
    columns = ", ".join(c.name for c in t.moves.columns)
    without_key = f"CREATE TABLE other AS SELECT {columns} FROM moves"
    twice = (
        f"INSERT INTO other SELECT {columns.replace('actor', chr(39) + 'nobody' + chr(39))} "
        "FROM moves"
    )
    edit(parts, without_key, twice, "DROP TABLE moves", "ALTER TABLE other RENAME TO moves")
    assert ("moves/p/1", "it is there more than once") in findings(parts)
    assert ("moves", "it is no table with the key plant, generation") in schema(parts)


@pytest.mark.parametrize(
    "storage", ["embedded"], indirect=True
)  # elsewhere a column of text holds text
def test_a_row_under_a_key_of_bytes_is_found(parts):
    token = TokenRecord(
        "carol", "0" * 64, "carol", ["operator"], None, None, CONTEXT.now, "tester", None
    )
    with writing(parts.database) as tx:
        issue_token(tx, token, CONTEXT)
    columns = [c.name for c in t.tokens.columns]
    other = {"prefix": "CAST(prefix AS BLOB)", "digest": "digest || '0'"}
    edit(
        parts,
        (
            f"INSERT INTO tokens ({', '.join(columns)}) SELECT "
            f"{', '.join(other.get(name, name) for name in columns)} FROM tokens"
        ),
    )
    assert any(
        where == "tokens" and "holds bytes in its column prefix" in what
        for where, what in findings(parts)
    )


def test_a_trigger_is_found(parts):
    if parts.database.is_sqlite:
        edit(parts, "CREATE TRIGGER planted AFTER INSERT ON episodes BEGIN DELETE FROM gates; END")
    else:
        edit(
            parts,
            "CREATE FUNCTION planted() RETURNS trigger LANGUAGE plpgsql AS 'BEGIN RETURN NEW; END'",
            (
                "CREATE TRIGGER planted AFTER INSERT ON episodes FOR EACH ROW EXECUTE "
                "FUNCTION planted()"
            ),
        )
    assert schema(parts) == [("episodes", "it has a trigger, planted")]


def test_every_table_of_the_log_has_its_key(parts):
    assert {table: KEYS[table] for table in KEYS} == {
        name: tuple(c.name for c in t.metadata.tables[name].primary_key) for name in KEYS
    }


@pytest.mark.parametrize("storage", ["embedded"], indirect=True)
def test_a_pipe_in_the_place_of_bytes_is_no_bytes(parts):
    digest = keep_bytes(parts, b"recorded")
    (found,) = parts.settings.data_dir.rglob(digest[2:])
    found.unlink()
    os.mkfifo(found)
    for act in (parts.blobs.get, lambda d: list(parts.blobs.stream(d))):
        with pytest.raises(BlobMissing):
            act(digest)
    assert not parts.blobs.holds(digest)
