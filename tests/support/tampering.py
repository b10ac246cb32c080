"""Flip one byte of what an installation keeps: of a row of the registry or the log, or of a
blob."""

from __future__ import annotations

import random
import sqlite3
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sqlalchemy import LargeBinary, select, text

from tests.support.gates import LENIENT
from tests.support.made import episode_bytes, plant_document, save
from trueup.episode.role import Role
from trueup.ledger.audit import AuditEntry, rebuild
from trueup.ledger.rows import KEYS, must_be_named
from trueup_client import Client
from trueup_service.registry.tables import metadata
from trueup_service.wiring import Parts

TAMPERED = [metadata.tables[name] for name in (*KEYS, "audit", "audit_tree", "audit_head")]


@dataclass(frozen=True)
class Flip:
    """A flip, and how to undo it."""

    where: str
    undo: Callable[[], None]


def promoted(client: Client, folder: Path) -> tuple[str, str]:
    """A plant `p` whose fitted candidate was judged and promoted; the candidate and the
    decision."""
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
    """Cut the log to a size, entries, tree and head alike, so that what is left is a sound log."""
    with parts.database.write() as connection:
        connection.execute(text("DELETE FROM audit WHERE sequence > :n"), {"n": size})
        connection.execute(
            text(
                "DELETE FROM audit_tree WHERE (((node & 281474976710655) + 1) << (node >> 48)) > :n"
            ),
            {"n": size},
        )
        frontier = rebuild(entries[:size]).to_bytes()
        connection.execute(
            text("UPDATE audit_head SET size = :n, frontier = :f"), {"n": size, "f": frontier}
        )


def flip(parts: Parts, rng: random.Random) -> Flip:
    """Flip a byte that is drawn from all that is kept, blobs as likely as tables."""
    return _flip_blob(parts, rng) if rng.random() < 0.3 else _flip_row(parts, rng)


def _flip_blob(parts: Parts, rng: random.Random) -> Flip:
    path = rng.choice(sorted((parts.settings.data_dir / "blobs").glob("??/*")))
    kept = path.read_bytes()
    path.write_bytes(_flipped(kept, rng))
    return Flip(f"blob {path.name}", lambda: path.write_bytes(kept) and None)


def _flip_row(parts: Parts, rng: random.Random) -> Flip:
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
    """Beside the service's own connections, which would refuse what breaks a reference."""

    def put(key: dict[str, Any], value: Any) -> None:
        kept = sqlite3.connect(parts.settings.data_dir / "trueup.sqlite")
        where = " AND ".join(f'"{name}" = ?' for name in key)
        done = kept.execute(
            f'UPDATE "{table.name}" SET "{column.name}" = ? WHERE {where}', (value, *key.values())
        )
        assert done.rowcount == 1
        kept.commit()
        kept.close()

    key = {c.name: row[c.name] for c in table.primary_key.columns}
    put(key, changed)
    after = key | ({column.name: changed} if column.primary_key else {})
    return Flip(f"{table.name}.{column.name} of {key}", lambda: put(after, row[column.name]))
