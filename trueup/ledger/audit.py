"""The audit log: entries that can only be added, each bound to the one before it.

An entry's digest is the SHA-256 of its canonical body, which holds the digest of the entry before it. So an edit, a removal
or a swap inside the log shows; a cut tail does not, unless somebody kept the last digest.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from trueup.canonical import Json, digest_of
from trueup.errors import BrokenChain

GENESIS = "0" * 64


@dataclass(frozen=True, slots=True)
class AuditEntry:
    """Who did what to which subject, when. `kind` is `subject:action`; `facts` is what a reader needs to check it."""

    sequence: int
    at: str
    kind: str
    actor: str
    plant: str | None
    subject: str
    facts: dict[str, Json]
    previous: str
    digest: str


def body(entry: AuditEntry) -> dict[str, Json]:
    """What an entry's digest is taken over."""
    return {
        "sequence": entry.sequence,
        "at": entry.at,
        "kind": entry.kind,
        "actor": entry.actor,
        "plant": entry.plant,
        "subject": entry.subject,
        "facts": entry.facts,
        "previous": entry.previous,
    }


def append(
    after: tuple[int, str], *, at: str, kind: str, actor: str, plant: str | None, subject: str, facts: dict[str, Json]
) -> AuditEntry:
    """The entry that follows the one with this sequence and digest."""
    unsigned = AuditEntry(after[0] + 1, at, kind, actor, plant, subject, facts, after[1], "")
    return AuditEntry(unsigned.sequence, at, kind, actor, plant, subject, facts, after[1], digest_of(body(unsigned)))


def verify(entries: Iterable[AuditEntry]) -> tuple[int, str]:
    """Sequence and digest of the last entry of a whole log, from its first. Raises BrokenChain."""
    last = 0, GENESIS
    for entry in entries:
        if (entry.sequence - 1, entry.previous) != last or digest_of(body(entry)) != entry.digest:
            raise BrokenChain(f"entry {entry.sequence} does not follow from entry {last[0]}", sequence=entry.sequence)
        last = entry.sequence, entry.digest
    return last
