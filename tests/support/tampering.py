"""Change one stored value: in a row of the registry or the log, or in a blob."""

from __future__ import annotations

import random
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import obstore
from sqlalchemy import LargeBinary, and_, create_engine, select, text

from tests.support.gates import LENIENT
from tests.support.made import episode_bytes, plant_document, save
from trueup.episode.role import Role
from trueup.ledger.audit import AuditEntry, rebuild
from trueup.ledger.rows import KEYS, must_be_named
from trueup_client import Client
from trueup_service.registry.folder_blobs import FolderBlobs
from trueup_service.registry.tables import metadata
from trueup_service.wiring import Parts

TAMPERED = [metadata.tables[name] for name in (*KEYS, "audit", "audit_tree", "audit_head")]


@dataclass(frozen=True)
class Flip:
    """Where a value was changed, and how to undo it."""

    where: str
    undo: Callable[[], None]


def promoted(client: Client, folder: Path) -> tuple[str, str]:
    """Registers a plant `p`, and fits, judges and promotes a candidate.

    Returns the digests of the candidate and of the decision.
    """
    client.register_plant(plant_document("p"))
    for seed, role in ((0, Role.ADAPTATION), (1, Role.VALIDATION)):
        client.upload_episode("p", save(folder, f"{seed}.mcap", episode_bytes(seed, role=role)))
    candidate = client.wait(client.submit("p", {"kind": "fit", "method": "residual"})["id"])[
        "result"
    ]["artifact"]
    gate = client.declare_gate("p", LENIENT)["digest"]
    decision = client.wait(
        client.submit("p", {"kind": "gate", "candidate": candidate, "gate": gate})["id"]
    )["result"]["decision"]
    client.promote("p", decision, 1)
    return candidate, decision


def cut(parts: Parts, entries: Sequence[AuditEntry], size: int) -> None:
    """Cuts the entries, the tree and the head of the log to a size, which leaves a sound log."""
    with parts.database.write() as connection:
        connection.execute(text("DELETE FROM audit WHERE sequence > :n"), {"n": size})
        connection.execute(
            text(
                "DELETE FROM audit_tree WHERE"
                " (((node & 281474976710655) + 1) << CAST(node >> 48 AS INTEGER)) > :n"
            ),
            {"n": size},
        )
        frontier = rebuild(entries[:size]).to_bytes()
        connection.execute(
            text("UPDATE audit_head SET size = :n, frontier = :f"), {"n": size, "f": frontier}
        )


def flip(parts: Parts, rng: random.Random) -> Flip:
    """Changes one value at random: of a blob with probability 0.3, else of a row."""
    return _flip_blob(parts, rng) if rng.random() < 0.3 else flip_row(parts, rng)


def _flip_blob(parts: Parts, rng: random.Random) -> Flip:
    digest = rng.choice(sorted(parts.blobs.all()))
    original = parts.blobs.get(digest)
    _put(parts, digest, _flipped(original, rng))
    return Flip(f"blob {digest}", lambda: _put(parts, digest, original))


def _put(parts: Parts, digest: str, data: bytes) -> None:
    """Writes past the store's own `put`, which leaves alone what is there."""
    if isinstance(parts.blobs, FolderBlobs):
        (parts.settings.data_dir / "blobs" / digest[:2] / digest[2:]).write_bytes(data)
    else:
        obstore.put(parts.blobs._store, digest, data)  # type: ignore[attr-defined]


def flip_row(parts: Parts, rng: random.Random) -> Flip:
    """Changes one value of a row at random."""
    while True:
        table = rng.choice(TAMPERED)
        with parts.database.read() as connection:
            rows = [
                r
                for r in connection.execute(select(table)).mappings()
                if table.name not in KEYS or must_be_named(table.name, r)
            ]
        if not rows:
            continue
        row = rng.choice(rows)
        column = rng.choice([c for c in table.columns if row[c.name] is not None])
        changed = _changed(row[column.name], column.type, rng)
        if column.primary_key and any(r[column.name] == changed for r in rows):
            continue
        if not parts.database.is_sqlite and isinstance(changed, str) and "\0" in changed:
            continue  # PostgreSQL holds no such text
        return _write(parts, table, row, column, changed)


def _changed(value: Any, kind: Any, rng: random.Random) -> Any:
    if isinstance(kind, LargeBinary):
        return _flipped(value, rng)
    if isinstance(value, bool):
        return not value
    if isinstance(value, int):
        return value ^ (1 << rng.randrange(8))
    if isinstance(value, float):
        return value + 1.0
    return _flipped(value.encode(), rng).decode("latin-1") if value else "x"


def _flipped(data: bytes, rng: random.Random) -> bytes:
    at = rng.randrange(len(data))
    return data[:at] + bytes([data[at] ^ (1 << rng.randrange(7))]) + data[at + 1 :]


def _write(parts: Parts, table: Any, row: Any, column: Any, changed: Any) -> Flip:
    """Writes past the service's own connections, which would refuse to break a reference."""

    def put(key: dict[str, Any], value: Any) -> None:
        engine = create_engine(parts.settings.sqlalchemy_url)
        with engine.begin() as connection:
            if not parts.database.is_sqlite:
                connection.execute(text("SET session_replication_role = replica"))
            here = and_(*(table.c[name] == part for name, part in key.items()))
            done = connection.execute(table.update().where(here).values({column.name: value}))
            assert done.rowcount == 1
        engine.dispose()

    key = {c.name: row[c.name] for c in table.primary_key.columns}
    put(key, changed)
    after = key | ({column.name: changed} if column.primary_key else {})
    return Flip(f"{table.name}.{column.name} of {key}", lambda: put(after, row[column.name]))
