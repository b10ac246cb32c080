"""An installation's own database and blobs as what is verified, without a server, and what else
must hold there."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from sqlalchemy.exc import SQLAlchemyError

from trueup.canonical import Json
from trueup.errors import TrueupError
from trueup.ledger.audit import AuditEntry
from trueup.ledger.merkle import Node, node_of
from trueup.ledger.rows import KEYS, blobs
from trueup.ledger.signed_note import head_of, signed_with
from trueup.ledger.verification import Finding
from trueup_service.registry import tables as t
from trueup_service.registry.blobs import Blobs
from trueup_service.registry.database import Database
from trueup_service.registry.store import Reader
from trueup_service.signed_log import CHECKPOINT_FILE, own_key, root_at
from trueup_service.wiring import Parts

AT_ONCE = 1000


class Kept:
    """What a database and a blob store keep."""

    def __init__(self, database: Database, blobs: Blobs, signer: str | None = None) -> None:
        self._database, self._blobs, self._signer = database, blobs, signer

    def signer(self) -> str | None:
        """The key that signs here, where it is at hand."""
        return self._signer

    def head(self) -> tuple[int, bytes]:
        """The log as it stands, unsigned."""
        with self._database.read() as connection:
            tree = Reader(connection).audit_tree()
        return tree.size, tree.root()

    def entries(self, after: int, until: int) -> Iterator[AuditEntry]:
        """Entries in order."""
        while after < until:
            with self._database.read() as connection:
                try:
                    found = Reader(connection).audit_entries(after, min(AT_ONCE, until - after))
                except ValueError as error:
                    raise TrueupError(f"an entry after {after} cannot be read: {error}") from error
            if not found:
                return
            yield from found
            after = found[-1].sequence

    def nodes(self) -> Iterator[tuple[Node, bytes]]:
        """The hashes that are kept."""
        for row in self.rows(t.audit_tree.name):
            found: Any = row
            yield node_of(int(found["node"])), bytes.fromhex(found["hash"])

    def rows(self, table: str) -> Iterator[dict[str, Json]]:
        """Rows as they are stored."""
        found = t.metadata.tables[table]
        after: list[Any] = []
        columns = [c.name for c in found.primary_key.columns]
        while True:
            try:
                with self._database.read() as connection:
                    items = Reader(connection).rows(found, after, AT_ONCE)
            except (SQLAlchemyError, ValueError) as error:
                raise TrueupError(f"rows cannot be read: {type(error).__name__}") from error
            yield from items
            if len(items) < AT_ONCE:
                return
            after = [
                c.type.python_type(items[-1][c.name]) for c in (found.c[name] for name in columns)
            ]

    def blob(self, digest: str) -> Iterator[bytes]:
        """Bytes in parts."""
        return self._blobs.stream(digest)


def published(parts: Parts) -> list[Finding]:
    """Whether the log ends where it says, and extends the head that this installation has
    published."""
    path = parts.settings.data_dir / CHECKPOINT_FILE
    with parts.database.read() as connection:
        beyond = Reader(connection).audit_beyond()
    if beyond:
        return [Finding("log", f"{beyond} entries are kept behind its end")]
    if not path.exists():
        return []
    note = path.read_text()
    size, root = head_of(note)
    try:
        with parts.database.read() as connection:
            reader = Reader(connection)
            now, keys = reader.audit_tree().size, [key.verifier for key in reader.audit_keys()]
            same = now >= size and root_at(reader, size) == root
    except TrueupError as error:
        return [Finding("log", error.message)]
    found = (
        []
        if same
        else [
            Finding(
                "log", f"of {size} entries that were published, {now} are there, or they are others"
            )
        ]
    )
    if not any(signed_with(note, key) for key in keys):
        found.append(
            Finding(
                t.audit_key.name, "none of the keys that are kept has signed what was published"
            )
        )
    return found


def signing(parts: Parts) -> str | None:
    """The key that signs here, if a head was ever published and the key is at hand. Raises
    BadKey."""
    return own_key(parts.settings) if (parts.settings.data_dir / CHECKPOINT_FILE).exists() else None


def lost_jobs(parts: Parts) -> list[Finding]:
    """Jobs that were accepted, have not ended, and that the engine does not know."""
    with parts.database.read() as connection:
        waiting = Reader(connection).jobs_under_way()
    return [
        Finding(f"jobs/{job}", "it was accepted, and the job engine does not know it")
        for job in waiting
        if not parts.queue.knows(job)
    ]


def unnamed(parts: Parts) -> list[str]:
    """Digests of blobs that no row names."""
    kept = Kept(parts.database, parts.blobs)
    named = {digest for table in KEYS for row in kept.rows(table) for digest in blobs(table, row)}
    return [digest for digest in parts.blobs.all() if digest not in named]
