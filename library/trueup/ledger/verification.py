"""Verify a registry against its log: every entry, every row, every byte. What does not agree is
listed, not raised.

- the tree of all entries has the root that was signed, and the stored hashes, head and keys are
  those of the entries and no others;
- every row is as the last entry that names it left it, every row is named, and every named row is
  there;
- what is named by its content has that content, bytes included;
- every move of a pointer is named by an entry of a kind that may move it.
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
    KEYS,
    MOVES,
    NOT_OF_A_PLANT,
    WHOLESALE,
    blobs,
    misnamed,
    must_be_named,
    row_digest,
    row_name,
)

Progress = Callable[[float, str], None]  # a share of the work that is done, and what is under way
HEAD, KEY = "audit_head", "audit_key"
READS = 8  # of rows that change while they are read, before a difference counts


class Registry(Protocol):
    """A registry that is verified: of a service, in a database, in an archive."""

    def head(self) -> tuple[int, bytes]:
        """Number of entries and root, as they were signed."""

    def entries(self, after: int, until: int) -> Iterable[AuditEntry]:
        """Entries in order, from behind `after` up to `until`, by sequence number."""

    def nodes(self) -> Iterable[tuple[Node, bytes]] | None:
        """Every stored hash of the tree; None where none are stored."""

    def signer(self) -> str | None:
        """The public key that signs the log now; None where nobody can say."""

    def rows(self, table: str) -> Iterable[Mapping[str, Json]]:
        """Every row of a table, as it is stored."""

    def blob(self, digest: str) -> Iterator[bytes]:
        """The bytes of a blob, in parts. Raises TrueupError where they are not there."""


@dataclass(frozen=True, slots=True)
class Finding:
    """Something that does not agree with the log: an entry, a row or a blob, and how it differs."""

    where: str
    what: str


EntryCheck = Callable[[AuditEntry], Iterable[Finding]]


@dataclass
class _Log:
    """The log as far as it was read: its tree, and for each row that it names its digest and the
    entry that named it last. `requests` are digests of jobs' requests as they were submitted,
    `key_changes` the entries that replace the key.
    """

    check: EntryCheck
    tree: Frontier = NOTHING
    nodes: dict[Node, bytes] = field(default_factory=dict)
    named: dict[str, tuple[str, AuditEntry]] = field(default_factory=dict)
    requests: dict[str, str] = field(default_factory=dict)
    key_changes: list[AuditEntry] = field(default_factory=list)

    def read(self, registry: Registry) -> list[Finding]:
        """Read on to the signed head; what does not agree."""
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
                    self.requests[entry.subject] = digest_of(entry.facts["request"])
                if entry.kind == "key:replaced":
                    self.key_changes.append(entry)
                findings += self.check(entry)
        except TrueupError as error:
            return [Finding("log", error.message)]
        if self.tree.size != size:
            return [Finding("log", f"it ends at entry {self.tree.size}, {size} were signed for")]
        if self.tree.root() != root:
            return [Finding("log", f"its {size} entries do not have the root that was signed")]
        return findings


@dataclass(frozen=True)
class Verified:
    """The result of a verification: the size and root of the log, how many rows were compared and
    bytes hashed, the digests of all decisions, and what does not agree."""

    size: int
    root: bytes
    rows: int
    bytes: int
    decisions: list[str]
    findings: list[Finding]


def verify(
    registry: Registry,
    progress: Progress = lambda _share, _stage: None,
    check: EntryCheck = lambda _entry: (),
) -> Verified:
    """Verify a registry, which may be written to meanwhile. `check` gets every entry and returns
    what is wrong with it."""
    log = _Log(check)
    progress(0.0, "reading the log")
    findings = log.read(registry) or _check_tree(registry, log)
    if findings:
        return Verified(log.tree.size, log.tree.root(), 0, 0, [], findings)
    return _check_rows(registry, log, progress)


def verify_part(
    registry: Registry,
    entries: Iterable[AuditEntry],
    progress: Progress = lambda _share, _stage: None,
) -> Verified:
    """Verify the rows that a part of the log names. The caller has proven its entries to be in the
    log."""
    log = _Log(lambda _: ())
    for entry in entries:
        log.named |= {
            name: (digest, entry)
            for name, digest in entry.rows.items()
            if _table_of(name) not in NOT_OF_A_PLANT
        }
    return _check_rows(registry, log, progress, rereads=0)  # the log does not grow


def _check_rows(
    registry: Registry, log: _Log, progress: Progress, rereads: int = READS
) -> Verified:
    """Compare every table with the log and hash every blob. A table that differs is read again up
    to `rereads` times, for it may have been written to."""
    findings: list[Finding] = []
    named: dict[str, list[str]] = {}
    compared, decisions = 0, []
    for count, table in enumerate(KEYS):
        progress(0.2 + 0.3 * count / len(KEYS), f"holding {table} against the log")
        for _ in range(rereads + 1):
            rows, unread = _read(registry, table)
            if rereads:
                findings += log.read(registry)  # entries written before the rows were read
            wrong = unread or _differing(log, table, rows)
            if not wrong:
                break
        findings += wrong
        compared += len(rows)
        for row in rows:
            decisions += [str(row["digest"])] if table == "decisions" else []
            for digest in blobs(table, row):
                named.setdefault(digest, []).append(row_name(table, row))
    hashed, damaged = _hash(
        registry, named, lambda share: progress(0.5 + 0.5 * share, "hashing episodes and artifacts")
    )
    return Verified(log.tree.size, log.tree.root(), compared, hashed, decisions, findings + damaged)


def _check_tree(registry: Registry, log: _Log) -> list[Finding]:
    """Compare the stored hashes of the tree, its head and its keys with the entries."""
    expected = dict(log.nodes)
    try:
        nodes = registry.nodes()
        if nodes is None:
            return []
        stored = dict(nodes)
        findings = log.read(registry)  # entries written before the hashes were read
        heads, keys = (list(registry.rows(table)) for table in (HEAD, KEY))
        signer = registry.signer()
    except TrueupError as error:
        return [Finding("tree", error.message)]
    wrong = [node for node, hashed in expected.items() if stored.get(node) != hashed]
    findings += [
        Finding(f"tree/{level}/{position}", "it is not the hash of its entries")
        for level, position in wrong
    ]
    beyond = [node for node in stored if node not in log.nodes]
    findings += [
        Finding(f"tree/{level}/{position}", "it is the hash of no entries")
        for level, position in beyond
    ]
    if [row["id"] for row in heads] != [1]:
        findings.append(Finding(HEAD, f"{len(heads)} heads of the log are kept, and it has one"))
    return findings + _check_keys(log.key_changes, keys, signer)


def _check_keys(
    changes: Sequence[AuditEntry], keys: Sequence[Mapping[str, Any]], signer: str | None
) -> list[Finding]:
    """Compare the stored keys with the entries that replaced a key, and with the key that signs
    now."""
    if not keys and not changes and signer is None:
        return []  # nobody has signed yet
    findings = []
    if [row["id"] for row in keys] != list(range(1, len(changes) + 2)):
        findings.append(
            Finding(KEY, f"{len(keys)} keys are kept, and by the log there were {len(changes) + 1}")
        )
    # A first key that was never replaced stands in no entry: it is compared with the signer, below.
    first = changes[0].facts["before"] if changes else None
    expected = [(first, None), *((e.subject, e.facts["endorsement"]) for e in changes)]
    for row, (verifier, endorsement) in zip(keys, expected, strict=False):
        if (row["verifier"], row["endorsement"]) != (verifier or row["verifier"], endorsement):
            findings.append(
                Finding(f"{KEY}/{row['id']}", "it is not the key that the log tells of")
            )
    if signer is not None and keys and keys[-1]["verifier"] != signer:
        findings.append(Finding(f"{KEY}/{keys[-1]['id']}", "it is not the key that signs the log"))
    return findings


def _read(registry: Registry, table: str) -> tuple[list[Mapping[str, Any]], list[Finding]]:
    """The rows of a table, or a finding where they cannot be read."""
    try:
        return list(registry.rows(table)), []
    except TrueupError as error:
        return [], [Finding(table, error.message)]


def _differing(log: _Log, table: str, rows: Sequence[Mapping[str, Any]]) -> list[Finding]:
    """What of a table's rows does not agree with the log."""
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
        if _table_of(name) == table and name not in there
    ]
    return wrong


def _table_of(name: str) -> str:
    """The table in the name of a row."""
    return name.partition("/")[0]


def _differs(log: _Log, table: str, name: str, row: Mapping[str, Any]) -> str | None:
    """How a row differs from what the log tells of it, in words; None where it does not."""
    if (
        table == "jobs"
        and row["id"] in log.requests
        and digest_of_bytes(str(row["request"]).encode()) != log.requests[row["id"]]
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
    registry: Registry, named: Mapping[str, list[str]], progress: Callable[[float], None]
) -> tuple[int, list[Finding]]:
    """Hash every blob once. Returns the number of bytes hashed, and what does not match its
    name."""
    size, findings = 0, []
    for count, (digest, rows) in enumerate(named.items(), 1):
        hashed = hashlib.sha256()
        try:
            for part in registry.blob(digest):
                hashed.update(part)
                size += len(part)
        except TrueupError as error:
            findings.append(Finding(rows[0], error.message))
        else:
            if hashed.hexdigest() != digest:
                findings.append(Finding(rows[0], f"its bytes hash to {hashed.hexdigest()}"))
        progress(count / len(named))
    return size, findings
