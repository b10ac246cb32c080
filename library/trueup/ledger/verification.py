"""Hold a registry against its log: every entry, every row, every byte. What does not agree is
listed, not raised.

- the tree of all entries has the root that was signed, and its kept hashes, head and keys are those
  of the entries and no others;
- every row is as the last entry that names it left it, every row is named, and every named row is
  there;
- what is named by its content has that content, bytes included;
- every move of a pointer is told by an entry that may tell of one.
"""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

from trueup.canonical import Json, digest_of, digest_of_bytes
from trueup.errors import TrueupError
from trueup.ledger.audit import AuditEntry, entry_bytes
from trueup.ledger.merkle import NOTHING, Frontier, Node, leaf_hash
from trueup.ledger.rows import (
    KEPT_APART,
    KEYS,
    MOVES,
    WHOLESALE,
    blobs,
    misnamed,
    must_be_named,
    row_digest,
    row_name,
)

Told = Callable[[float, str], None]
HEAD, KEY = "audit_head", "audit_key"
LOOKS = 8  # at rows that change while they are read, before what does not agree counts


class Registry(Protocol):
    """What is verified, wherever it is: a service, a database, an export."""

    def head(self) -> tuple[int, bytes]:
        """Number of entries and root, as they were signed."""

    def entries(self, after: int, until: int) -> Iterable[AuditEntry]:
        """Entries in order, from behind one up to another."""

    def nodes(self) -> Iterable[tuple[Node, bytes]] | None:
        """Every hash of the tree that is kept; None where it is rebuilt."""

    def signer(self) -> str | None:
        """The public key that signs the log now; None where nobody can say."""

    def rows(self, table: str) -> Iterable[Mapping[str, Json]]:
        """Every row of a table, as it is stored."""

    def blob(self, digest: str) -> Iterator[bytes]:
        """Bytes in parts. Raises TrueupError where they are not there."""


@dataclass(frozen=True, slots=True)
class Finding:
    """What does not agree: an entry, a row or a blob, and how."""

    where: str
    what: str


Each = Callable[[AuditEntry], Iterable[Finding]]


@dataclass
class _Log:
    """The log as far as it was read: its tree, and of every row its digest and the entry that last
    named it."""

    each: Each
    tree: Frontier = NOTHING
    nodes: dict[Node, bytes] = field(default_factory=dict)
    named: dict[str, tuple[str, AuditEntry]] = field(default_factory=dict)
    asked: dict[str, str] = field(
        default_factory=dict
    )  # the digest of each job's request, as it was submitted
    keys: list[AuditEntry] = field(default_factory=list)  # that tell of a key which took over

    def read(self, registry: Registry) -> list[Finding]:
        """Read on to the signed head."""
        findings: list[Finding] = []
        try:
            size, root = registry.head()
            for entry in registry.entries(self.tree.size, size):
                if entry.sequence != self.tree.size + 1:
                    return [
                        Finding("log", f"entry {entry.sequence} follows entry {self.tree.size}")
                    ]
                self.tree, completed = self.tree.append(leaf_hash(entry_bytes(entry)))
                self.nodes |= completed
                self.named |= {name: (digest, entry) for name, digest in entry.rows.items()}
                if entry.kind == "job:submitted":
                    self.asked[entry.subject] = digest_of(entry.facts["request"])
                if entry.kind == "key:replaced":
                    self.keys.append(entry)
                findings += self.each(entry)
        except TrueupError as error:
            return [Finding("log", error.message)]
        if self.tree.size != size:
            return [Finding("log", f"it ends at entry {self.tree.size}, {size} were signed for")]
        if self.tree.root() != root:
            return [Finding("log", f"its {size} entries do not have the root that was signed")]
        return findings


@dataclass(frozen=True)
class Verified:
    """What was verified: entries and rows held, bytes hashed, and what does not agree. `decisions`
    are the digests of all decisions."""

    size: int
    root: bytes
    rows: int
    bytes: int
    decisions: list[str]
    findings: list[Finding]


def verify(
    registry: Registry, told: Told = lambda _share, _stage: None, each: Each = lambda _entry: ()
) -> Verified:
    """Verify a registry, which may be written to meanwhile; `each` looks at every entry, too, and
    says what it finds wrong."""
    log = _Log(each)
    told(0.0, "reading the log")
    findings = log.read(registry) or _hold_tree(registry, log)
    if findings:
        return Verified(log.tree.size, log.tree.root(), 0, 0, [], findings)
    return _hold_all(registry, log, told)


def verify_part(
    registry: Registry, entries: Iterable[AuditEntry], told: Told = lambda _share, _stage: None
) -> Verified:
    """Verify what a part of the log tells of; whoever calls has proven its entries to be in the
    log."""
    log = _Log(lambda _: ())
    for entry in entries:
        log.named |= {
            name: (digest, entry)
            for name, digest in entry.rows.items()
            if _of(name) not in KEPT_APART
        }
    return _hold_all(registry, log, told, looks=0)  # there is nothing more to read


def _hold_all(registry: Registry, log: _Log, told: Told, looks: int = LOOKS) -> Verified:
    """Hold every table and every blob."""
    findings: list[Finding] = []
    named: dict[str, list[str]] = {}
    held, decisions = 0, []
    for count, table in enumerate(KEYS):
        told(0.2 + 0.3 * count / len(KEYS), f"holding {table} against the log")
        for look in range(looks + 1):
            rows, unread = _read(registry, table)
            if looks:
                findings += log.read(registry)  # whatever was written before these rows were read
            wrong = unread or _differing(log, table, rows)
            if not wrong or look == looks or not looks:
                break
        findings += wrong
        held += len(rows)
        for row in rows:
            decisions += [str(row["digest"])] if table == "decisions" else []
            for digest in blobs(table, row):
                named.setdefault(digest, []).append(row_name(table, row))
    hashed, damaged = _hash(
        registry, named, lambda share: told(0.5 + 0.5 * share, "hashing episodes and artifacts")
    )
    return Verified(log.tree.size, log.tree.root(), held, hashed, decisions, findings + damaged)


def _hold_tree(registry: Registry, log: _Log) -> list[Finding]:
    """Hold what the log keeps beside its entries, the hashes from which proofs are made, its head
    and its keys, against the entries."""
    made = dict(log.nodes)
    try:
        nodes = registry.nodes()
        if nodes is None:
            return []
        kept = dict(nodes)
        findings = log.read(registry)  # whatever was written before these were read
        heads, keys = (list(registry.rows(table)) for table in (HEAD, KEY))
        signer = registry.signer()
    except TrueupError as error:
        return [Finding("tree", error.message)]
    wrong = [node for node, found in made.items() if kept.get(node) != found]
    findings += [
        Finding(f"tree/{level}/{position}", "it is not the hash of its entries")
        for level, position in wrong
    ]
    beyond = [node for node in kept if node not in log.nodes]
    findings += [
        Finding(f"tree/{level}/{position}", "it is the hash of no entries")
        for level, position in beyond
    ]
    if [row["id"] for row in heads] != [1]:
        findings.append(Finding(HEAD, f"{len(heads)} heads of the log are kept, and it has one"))
    return findings + _hold_keys(log.keys, keys, signer)


def _hold_keys(
    replaced: Sequence[AuditEntry], keys: Sequence[Mapping[str, Any]], signer: str | None
) -> list[Finding]:
    """Hold the keys that are kept against the entries that tell of each that took over, and against
    the one that signs now."""
    if not keys and not replaced and signer is None:
        return []  # nobody has signed yet
    findings = []
    if [row["id"] for row in keys] != list(range(1, len(replaced) + 2)):
        findings.append(
            Finding(
                KEY, f"{len(keys)} keys are kept, and by the log there were {len(replaced) + 1}"
            )
        )
    told = [(entry.subject, entry.facts["endorsement"]) for entry in replaced]
    first = (
        replaced[0].facts["before"] if replaced else None
    )  # then only whoever signs can tell, below
    for row, (verifier, endorsement) in zip(keys, [(first, None), *told], strict=False):
        if (row["verifier"], row["endorsement"]) != (verifier or row["verifier"], endorsement):
            findings.append(
                Finding(f"{KEY}/{row['id']}", "it is not the key that the log tells of")
            )
    if signer is not None and keys and keys[-1]["verifier"] != signer:
        findings.append(Finding(f"{KEY}/{keys[-1]['id']}", "it is not the key that signs the log"))
    return findings


def _read(registry: Registry, table: str) -> tuple[list[Mapping[str, Any]], list[Finding]]:
    try:
        return list(registry.rows(table)), []
    except TrueupError as error:
        return [], [Finding(table, error.message)]


def _differing(log: _Log, table: str, rows: Sequence[Mapping[str, Any]]) -> list[Finding]:
    """Hold a table's rows against the log."""
    there = {row_name(table, row): row for row in rows}
    often = Counter(row_name(table, row) for row in rows)
    wrong = [
        Finding(name, "it is there more than once") for name, count in often.items() if count > 1
    ]
    wrong += [
        Finding(name, what)
        for name, row in there.items()
        if (what := _differs(log, table, name, row))
    ]
    wrong += [
        Finding(name, "the log names it, and it is not there")
        for name in log.named
        if _of(name) == table and name not in there
    ]
    return wrong


def _of(name: str) -> str:
    return name.partition("/")[0]


def _differs(log: _Log, table: str, name: str, row: Mapping[str, Any]) -> str | None:
    if (
        table == "jobs"
        and row["id"] in log.asked
        and digest_of_bytes(str(row["request"]).encode()) != log.asked[row["id"]]
    ):
        return "its request is not the one that was submitted"
    if name not in log.named:
        return "no entry of the log tells of it" if must_be_named(table, row) else None
    digest, entry = log.named[name]
    if row_digest(table, row) != digest:
        return f"it is not as entry {entry.sequence} ({entry.kind}) left it"
    if table in MOVES and entry.kind not in (*MOVES[table], *WHOLESALE):
        return f"entry {entry.sequence} ({entry.kind}) cannot tell of a move"
    return misnamed(table, row)


def _hash(
    registry: Registry, named: Mapping[str, list[str]], told: Callable[[float], None]
) -> tuple[int, list[Finding]]:
    """Hash every blob once; the bytes that were hashed, and what is not as it is named."""
    hashed, findings = 0, []
    for count, (digest, rows) in enumerate(named.items(), 1):
        found = hashlib.sha256()
        try:
            for part in registry.blob(digest):
                found.update(part)
                hashed += len(part)
        except TrueupError as error:
            findings.append(Finding(rows[0], error.message))
        else:
            if found.hexdigest() != digest:
                findings.append(Finding(rows[0], f"its bytes hash to {found.hexdigest()}"))
        told(count / len(named))
    return hashed, findings
