"""Export a registry or one plant as an archive, and restore or import it.

Rows come from one snapshot, and bytes are named by digest and never removed while a row names them.
So an archive that is made while the service runs shows one moment. An archive is verified before
anything of it is stored.
"""

from __future__ import annotations

import hashlib
import uuid
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import orjson
from sqlalchemy import Table
from sqlalchemy.exc import IntegrityError

from trueup.canonical import Json
from trueup.gate.line import SHOWING
from trueup.ledger.archive import Archive, Includes, dangling_rows, foreign_rows, unproven
from trueup.ledger.archive_layout import (
    ARRAYS,
    ENTRIES,
    EPISODE,
    OUTPUT,
    ROWS,
    entry_line,
    lines,
)
from trueup.ledger.archive_writer import ArchiveWriter
from trueup.ledger.merkle import inclusion, prove
from trueup.ledger.rows import KEYS, NOT_OF_A_PLANT, blobs, must_be_named
from trueup.ledger.verification import verify, verify_part
from trueup_service.actions import find
from trueup_service.actor_context import ActorContext
from trueup_service.errors import Conflict, NotEmpty, NotWhole
from trueup_service.registry import tables as t
from trueup_service.registry.blobs import Blobs
from trueup_service.registry.records import ImportRecord
from trueup_service.registry.transaction import ReadTransaction, Transaction, reading, writing
from trueup_service.signed_log import SignedLog
from trueup_service.wiring import Parts

AT_ONCE = 1000
# archived of a whole registry, though the log does not name them
WITHOUT_ENTRIES = "audit_key", "job_reads", "idempotency"
NAMES = {
    EPISODE: "episodes/{}.mcap",
    ARRAYS: "arrays/{}.safetensors",
    ENTRIES: "imported/{}.jsonl",
    OUTPUT: "outputs/{}",
}
KINDS = {"episodes": EPISODE, "artifacts": ARRAYS, "imports": ENTRIES, "outputs": OUTPUT}
Progress = Callable[[float, str], None]


def export(
    parts: Parts, log: SignedLog, path: Path, plant: str | None, now: str, progress: Progress
) -> str:
    """Write an archive of a registry, or of one plant, and return its digest. Raises NotFound."""
    with parts.database.snapshot() as connection, ArchiveWriter(path) as archive:
        tx = ReadTransaction(connection)
        tree = tx.log.tree()
        if plant is not None:
            find.plant_digest(tx, plant)
        named: dict[str, str] = {}
        for count, table in enumerate(KEYS):
            progress(0.2 * count / len(KEYS), table)
            if plant is not None and table in NOT_OF_A_PLANT:
                continue
            rows = [
                row
                for row in _rows(tx, t.metadata.tables[table], plant)
                if plant is None or must_be_named(table, row)
            ]
            archive.add(f"rows/{table}.jsonl", ROWS, lines(rows))
            named |= {digest: KINDS[table] for row in rows for digest in blobs(table, row)}
        for table in WITHOUT_ENTRIES if plant is None else ():
            archive.add(
                f"beside/{table}.jsonl", ROWS, lines(_rows(tx, t.metadata.tables[table], None))
            )
        archive.add("log/entries.jsonl", ENTRIES, lines(_entries(tx, plant, tree.size)))
        for count, (digest, kind) in enumerate(sorted(named.items()), 1):
            progress(0.2 + 0.8 * count / len(named), f"blob {digest[:12]}")
            size = sum(map(len, parts.blobs.stream(digest)))
            archive.add_parts(
                NAMES[kind].format(digest), kind, digest, size, parts.blobs.stream(digest)
            )
        config = {
            "plant": plant,
            "key": log.signer.verifier,
            "endorsements": [key.endorsement for key in tx.log.signing_keys() if key.endorsement],
            "checkpoint": log.checkpoint_of(tx, tree),
            "created_at": now,
        }
        return archive.close(config, log.signer.note)


def _rows(tx: ReadTransaction, table: Table, plant: str | None) -> Iterator[dict[str, Json]]:
    after: list[Any] = []
    while True:
        rows = tx.rows.page(table, after, AT_ONCE, plant)
        yield from rows
        if len(rows) < AT_ONCE:
            return
        after = [
            column.type.python_type(rows[-1][column.name]) for column in table.primary_key.columns
        ]


def _entries(tx: ReadTransaction, plant: str | None, size: int) -> Iterator[dict[str, Json]]:
    """All entries, or those of a plant, each with the proof that it is in the log of this size."""
    after = 0
    while entries := tx.log.entries(after, AT_ONCE, plant):
        for entry in entries:
            plan = [] if plant is None else inclusion(entry.sequence - 1, size)
            yield entry_line(
                entry, prove(plan, tx.log.nodes([n for part in plan for n in part])) if plan else ()
            )
        after = entries[-1].sequence


def require_whole(archive: Archive, includes: Includes, progress: Progress) -> None:
    """Hold an archive against its own log. The caller has verified the signature of the log's head.
    Raises NotWhole, BadArchive."""
    if archive.plant is None:
        findings = verify(archive, progress).findings
    else:
        missing, others = unproven(archive, includes), foreign_rows(archive)
        if missing:
            raise NotWhole(
                (
                    f"{len(missing)} entries are not proven to be in the log, entry {missing[0]} "
                    "among them"
                ),
                entries=missing[:10],
            )
        hanging = dangling_rows(archive)
        if hanging:
            raise NotWhole(
                f"{len(hanging)} rows name what the archive does not hold, {hanging[0]} among them",
                rows=hanging[:10],
            )
        if others:
            raise NotWhole(
                f"{len(others)} rows are of another plant, {others[0]} among them", rows=others[:10]
            )
        findings = verify_part(
            archive, (entry for entry, _ in archive.entries_with_proofs()), progress
        ).findings
    if findings:
        first = findings[0]
        raise NotWhole(
            f"{len(findings)} things are not as the log says, such as {first.where}: {first.what}"
        )


def restore(parts: Parts, archive: Archive, progress: Progress) -> int:
    """Restore a whole registry into an empty one. Returns the number of unfinished jobs, which go
    on. Raises NotEmpty, NotWhole."""
    if archive.plant is not None:
        raise NotWhole("this is an archive of one plant", hint="`trueup import` takes it.")
    with reading(parts.database) as tx:
        if tx.log.tree().size:
            raise NotEmpty
    _take_blobs(parts, archive, progress)
    parts.queue.prepare()
    with writing(parts.database) as tx:
        for table in t.metadata.sorted_tables:
            if table.name in (*KEYS, *WITHOUT_ENTRIES):
                for row in archive.documents(
                    f"{'beside' if table.name in WITHOUT_ENTRIES else 'rows'}/{table.name}.jsonl"
                ):
                    tx.rows.restore_row(table, row)
        tx.log.restore(archive.entries(0, archive.head()[0]))
        jobs = tx.jobs.unfinished()
        for job in jobs:
            record = find.job(tx, job)
            parts.queue.enqueue(tx.connection, job, record.kind, record.plant)
    return len(jobs)


def import_plant(
    parts: Parts, archive: Archive, project: str | None, context: ActorContext, progress: Progress
) -> str:
    """Import a plant with its whole history, and return its name. Raises Conflict, NotFound,
    NotWhole."""
    plant = archive.plant
    if plant is None:
        raise NotWhole("this is an archive of a whole registry", hint="`trueup restore` takes it.")
    entries = archive.layer("log/entries.jsonl")
    if entries is None:
        raise NotWhole("the archive has no log")
    _take_blobs(parts, archive, progress)
    _take(parts.blobs, parts.spool, entries, archive.part(entries))
    note = str(archive.config["checkpoint"])
    with _taking_over(plant), writing(parts.database) as tx:
        tx.lock_name(f"plant {plant}")
        if project is not None:
            find.project(tx, project)
        if tx.plants.get(plant) is not None:
            raise Conflict(
                f"there is a plant {plant!r} already",
                hint="A plant is imported once, where there is none of its name.",
            )
        for table in t.metadata.sorted_tables:
            if table.name not in KEYS or table.name in (*NOT_OF_A_PLANT, t.imports.name):
                continue
            for row in archive.rows(table.name):
                if must_be_named(table.name, row):
                    tx.rows.import_row(
                        table, {**row, "project": project} if table is t.plants else row
                    )
                    _note_uses(tx, table, row)
        tx.imports.add(
            ImportRecord(
                plant=plant,
                archive=archive.digest,
                origin=note.split("\n", 1)[0],
                checkpoint=note,
                entries=entries,
                at=context.now,
                actor=context.actor,
            )
        )
        facts: dict[str, Json] = {
            "archive": archive.digest,
            "checkpoint": note,
            "key": str(archive.config["key"]),
            "entries": entries,
        }
        tx.log.append(context, "plant:imported", plant=plant, subject=archive.digest, facts=facts)
    return plant


@contextmanager
def _taking_over(plant: str) -> Iterator[None]:
    """Turns an IntegrityError into Conflict: a row of the archive has the key of a row that is
    here, such as a job of another plant."""
    try:
        yield
    except IntegrityError as error:
        raise Conflict(
            f"a row of plant {plant!r} has the name of another one here",
            hint="Nothing was taken in.",
        ) from error


def _note_uses(tx: Transaction, table: Table, row: Mapping[str, Any]) -> None:
    """Count the episodes that a gate has used elsewhere, or a study has shown errors on."""
    if table is t.jobs and row["kind"] in ("gate", *SHOWING):
        purpose = "gate" if row["kind"] == "gate" else "compare"
        tx.jobs.add_reads(str(row["id"]), orjson.loads(row["request"])["episodes"], purpose)


def _take_blobs(parts: Parts, archive: Archive, progress: Progress) -> None:
    digests = archive.blobs()
    for count, digest in enumerate(digests, 1):
        progress(count / len(digests), f"blob {digest[:12]}")
        _take(parts.blobs, parts.spool, digest, archive.blob(digest))


def _take(blobs: Blobs, spool: Path, digest: str, parts: Iterator[bytes]) -> None:
    """Store bytes, which are hashed on the way. Raises NotWhole where their digest is another."""
    path, hashed = spool / uuid.uuid4().hex, hashlib.sha256()
    try:
        with path.open("xb") as file:
            for part in parts:
                hashed.update(part)
                file.write(part)
        if hashed.hexdigest() != digest:
            raise NotWhole("bytes of the archive are not what they are named", digest=digest)
        blobs.put(digest, path)
    finally:
        path.unlink(missing_ok=True)
