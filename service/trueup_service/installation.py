"""An installation's own database and blobs, as a registry that can be verified without a server,
and further checks on them."""

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
from trueup_service.registry.transaction import reading
from trueup_service.signed_log import CHECKPOINT_FILE, own_key, root_at
from trueup_service.wiring import Parts

AT_ONCE = 1000


class Installation:
    """The registry in a database and a blob store, as `trueup.ledger.verification` reads one."""

    def __init__(self, database: Database, blobs: Blobs, signer: str | None = None) -> None:
        self._database, self._blobs, self._signer = database, blobs, signer

    def signer(self) -> str | None:
        """The public key that signs here, None where it is not at hand."""
        return self._signer

    def head(self) -> tuple[int, bytes]:
        """The size and the root of the log, unsigned."""
        with reading(self._database) as tx:
            tree = tx.log.tree()
        return tree.size, tree.root()

    def entries(self, after: int, until: int) -> Iterator[AuditEntry]:
        """Yields the entries behind one, up to another one. Raises TrueupError where an entry
        cannot be read."""
        while after < until:
            with reading(self._database) as tx:
                try:
                    page = tx.log.entries(after, min(AT_ONCE, until - after))
                except ValueError as error:
                    raise TrueupError(f"an entry after {after} cannot be read: {error}") from error
            if not page:
                return
            yield from page
            after = page[-1].sequence

    def nodes(self) -> Iterator[tuple[Node, bytes]]:
        """Yields the stored hashes of the tree."""
        for row in self.rows(t.audit_tree.name):
            node: Any = row
            yield node_of(int(node["node"])), bytes.fromhex(node["hash"])

    def rows(self, table: str) -> Iterator[dict[str, Json]]:
        """Yields the rows of a table as they are stored. Raises TrueupError where they cannot be
        read."""
        stored = t.metadata.tables[table]
        after: list[Any] = []
        columns = [c.name for c in stored.primary_key.columns]
        while True:
            try:
                with reading(self._database) as tx:
                    items = tx.rows.page(stored, after, AT_ONCE)
            except (SQLAlchemyError, ValueError) as error:
                raise TrueupError(f"rows cannot be read: {type(error).__name__}") from error
            yield from items
            if len(items) < AT_ONCE:
                return
            after = [
                c.type.python_type(items[-1][c.name]) for c in (stored.c[name] for name in columns)
            ]

    def blob(self, digest: str) -> Iterator[bytes]:
        """Yields the bytes of a blob in parts. Raises BlobMissing."""
        return self._blobs.stream(digest)


def published(parts: Parts) -> list[Finding]:
    """Findings where the log does not end at its head, or does not extend the head that this
    installation has published."""
    path = parts.settings.data_dir / CHECKPOINT_FILE
    with reading(parts.database) as tx:
        beyond = tx.log.count_beyond_end()
    if beyond:
        return [Finding("log", f"{beyond} entries are kept behind its end")]
    if not path.exists():
        return []
    note = path.read_text()
    size, root = head_of(note)
    try:
        with reading(parts.database) as tx:
            now, keys = tx.log.tree().size, [key.verifier for key in tx.log.signing_keys()]
            same = now >= size and root_at(tx, size) == root
    except TrueupError as error:
        return [Finding("log", error.message)]
    findings = (
        []
        if same
        else [
            Finding(
                "log", f"of {size} entries that were published, {now} are there, or they are others"
            )
        ]
    )
    if not any(signed_with(note, key) for key in keys):
        findings.append(
            Finding(
                t.audit_key.name, "none of the keys that are kept has signed what was published"
            )
        )
    return findings


def signing(parts: Parts) -> str | None:
    """The public key that signs here, where a head was published and the key is at hand. Raises
    BadKey."""
    return own_key(parts.settings) if (parts.settings.data_dir / CHECKPOINT_FILE).exists() else None


def lost_jobs(parts: Parts) -> list[Finding]:
    """Findings on jobs that were accepted, have not ended, and are unknown to the engine."""
    with reading(parts.database) as tx:
        waiting = tx.jobs.unfinished()
    return [
        Finding(f"jobs/{job}", "it was accepted, and the job engine does not know it")
        for job in waiting
        if not parts.queue.knows(job)
    ]


def unnamed_blobs(parts: Parts) -> list[str]:
    """The digests of blobs that no row names."""
    kept = Installation(parts.database, parts.blobs)
    named = {digest for table in KEYS for row in kept.rows(table) for digest in blobs(table, row)}
    return [digest for digest in parts.blobs.all() if digest not in named]
