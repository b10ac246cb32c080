"""The audit log: entries that can only be added, each a leaf of a Merkle tree.

A leaf is a small canonical document. It names by digest the `facts` of an entry, and every row of
the registry that its transaction wrote (`rows`). So the tree's root, which is signed and published,
covers every row: an edit, a removal or a swap of a row or an entry shows, and a cut tail shows to
whoever has an earlier root.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from trueup.canonical import Json, canonical_bytes, digest_of
from trueup.errors import BrokenChain
from trueup.ledger.merkle import NOTHING, Frontier, leaf_hash


@dataclass(frozen=True, slots=True)
class AuditEntry:
    """Who did what to which subject, when. `kind` is `subject:action`; `facts` is what a reader
    needs to check it.

    `rows` names what was written: `table/key` to the digest of the row as the transaction left it.
    """

    sequence: int
    at: str
    kind: str
    actor: str
    plant: str | None
    subject: str
    facts: Mapping[str, Json]
    rows: Mapping[str, str]


def entry_bytes(entry: AuditEntry) -> bytes:
    """An entry as the tree's leaf: canonical JSON."""
    return entry_bytes_of(entry, digest_of(entry.facts), digest_of(entry.rows))


def entry_bytes_of(entry: AuditEntry, facts_digest: str, rows_digest: str) -> bytes:
    """An entry whose facts and rows have these digests, as the tree's leaf: canonical JSON."""
    return canonical_bytes(
        {
            "sequence": entry.sequence,
            "at": entry.at,
            "kind": entry.kind,
            "actor": entry.actor,
            "plant": entry.plant,
            "subject": entry.subject,
            "facts_sha256": facts_digest,
            "rows_sha256": rows_digest,
        }
    )


def append(tree: Frontier, entry: AuditEntry) -> Frontier:
    """Returns the tree with one more entry. Raises BrokenChain if the entry is not the next one."""
    if entry.sequence != tree.size + 1:
        raise BrokenChain(
            f"entry {entry.sequence} follows entry {tree.size}", sequence=entry.sequence
        )
    return tree.append(leaf_hash(entry_bytes(entry)))[0]


def rebuild(entries: Iterable[AuditEntry]) -> Frontier:
    """Returns the tree of a whole log, from its first entry. Raises BrokenChain."""
    tree = NOTHING
    for entry in entries:
        tree = append(tree, entry)
    return tree
