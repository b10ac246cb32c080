"""The audit log: the one place that writes an entry, with the rows that it names and the tree over
all entries."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from datetime import datetime, timedelta
from typing import Any

from sqlalchemy import Select, bindparam, func, select, update

from trueup.canonical import Json, digest_of_bytes
from trueup.errors import BrokenChain
from trueup.ledger.audit import AuditEntry, entry_bytes_of
from trueup.ledger.merkle import Frontier, Node, leaf_hash, node_of, number_of
from trueup_service.actor_context import ActorContext, time_text
from trueup_service.registry import tables as t
from trueup_service.registry.records import AuditKey
from trueup_service.registry.repository import TableGateway, values_of
from trueup_service.registry.row_format import row_from_values

ESCAPE = "\\"
CLOCKS = timedelta(hours=1)  # by which the clocks of servers may differ

# Statements of the busiest paths, built once: building one costs about as much as running it.
_HEAD = select(t.audit_head.c.size, t.audit_head.c.frontier).where(t.audit_head.c.id == 1)
_LOCK_HEAD = _HEAD.with_for_update()
LOG_SIZE = select(t.audit_head.c.size).where(t.audit_head.c.id == 1).scalar_subquery()
_MOVE_HEAD = update(t.audit_head).values(
    size=bindparam("new_size"), frontier=bindparam("new_frontier")
)
_FIRST = (
    select(t.audit)
    .where(t.audit.c.subject == bindparam("of_subject"), t.audit.c.kind == bindparam("of_kind"))
    .order_by(t.audit.c.sequence)
    .limit(1)
)
_NEXT = (
    select(t.audit.c.sequence, t.audit.c.at)
    .where(
        t.audit.c.plant == bindparam("of_plant"),
        t.audit.c.sequence >= bindparam("from_sequence"),
    )
    .order_by(t.audit.c.sequence)
    .limit(1)
)
_NODES = select(t.audit_tree).where(t.audit_tree.c.node.in_(bindparam("nodes", expanding=True)))


class AuditLog:
    """Entries in order, and the Merkle tree whose leaves they are."""

    def __init__(self, gateway: TableGateway) -> None:
        self._gateway = gateway
        self._connection = gateway.connection
        self._tree: Frontier | None = None  # since the transaction holds its head

    def append(
        self,
        context: ActorContext,
        kind: str,
        *,
        plant: str | None,
        subject: str,
        facts: dict[str, Json],
    ) -> AuditEntry:
        """Add the next entry, which names every row written since the entry before.

        It comes last in a transaction: it waits for every other writer of the log, and makes those
        that follow wait until the commit.
        """
        if self._tree is None:
            head = self._connection.execute(_LOCK_HEAD).one()
            self._tree = Frontier.from_bytes(head.size, head.frontier)
        entry = AuditEntry(
            sequence=self._tree.size + 1,
            at=context.now,
            kind=kind,
            actor=context.actor,
            plant=plant,
            subject=subject,
            facts=facts,
            rows=self._gateway.take_notes(),
        )
        self._tree = self._add_leaf(self._tree, entry)
        self._move_head(self._tree)
        return entry

    def restore(self, entries: Iterable[AuditEntry]) -> None:
        """Add the entries of a whole log to an empty one, and build its tree anew."""
        tree = Frontier(0, ())
        for entry in entries:
            tree = self._add_leaf(tree, entry)
        self._move_head(tree)

    def _add_leaf(self, tree: Frontier, entry: AuditEntry) -> Frontier:
        """Add an entry and the nodes of the tree that it completes. Returns the tree with it."""
        row = row_from_values(t.audit, values_of(entry))
        digests = (digest_of_bytes(row[name].encode()) for name in ("facts", "rows"))
        grown, completed = tree.append(leaf_hash(entry_bytes_of(entry, *digests)))
        self._gateway.insert(t.audit, row)
        nodes = [{"node": number_of(node), "hash": digest} for node, digest in completed.items()]
        self._gateway.insert(t.audit_tree, nodes)
        return grown

    def _move_head(self, tree: Frontier) -> None:
        self._connection.execute(
            _MOVE_HEAD, {"new_size": tree.size, "new_frontier": tree.to_bytes()}
        )

    def size(self) -> int:
        """How many entries the log has."""
        return int(self._connection.scalar(select(LOG_SIZE)) or 0)

    def tree(self) -> Frontier:
        """The tree as it stands. Raises BrokenChain where the log has no head."""
        row = self._connection.execute(_HEAD).first()
        if row is None:
            raise BrokenChain("the log has no head")
        return Frontier.from_bytes(row.size, row.frontier)

    def entries(
        self, after: int, limit: int, plant: str | None = None, project: str | None = None
    ) -> list[AuditEntry]:
        """Entries in order from behind one: all of them, or those of a plant or of the plants of a
        project."""
        query = select(t.audit).where(t.audit.c.sequence > after, t.audit.c.sequence <= LOG_SIZE)
        query = _of(query, plant, project)
        return self._all(query.order_by(t.audit.c.sequence).limit(limit))

    def entries_of_kinds(
        self,
        after: int,
        limit: int,
        kinds: Collection[str],
        *,
        plant: str | None = None,
        project: str | None = None,
    ) -> list[AuditEntry]:
        """Entries of these kinds in order from behind one: of all plants, of one, or of those of a
        project. Entries of no plant are left out where a plant or project is named."""
        query = select(t.audit).where(
            t.audit.c.sequence > after, t.audit.c.sequence <= LOG_SIZE, t.audit.c.kind.in_(kinds)
        )
        return self._all(_of(query, plant, project).order_by(t.audit.c.sequence).limit(limit))

    def newest_entries(
        self,
        before: int,
        limit: int,
        *,
        after: int = 0,
        plant: str | None = None,
        project: str | None = None,
        kind: str = "",
    ) -> list[AuditEntry]:
        """Entries before one and behind another, the newest first: all of them, or those of a plant
        or of the plants of a project. `kind` selects the entries whose kind begins with it."""
        between = t.audit.c.sequence < before, t.audit.c.sequence > after
        query = _of(select(t.audit).where(*between), plant, project)
        if kind:
            query = query.where(t.audit.c.kind.startswith(kind, autoescape=True, escape=ESCAPE))
        return self._all(query.order_by(t.audit.c.sequence.desc()).limit(limit))

    def entries_between(self, plant: str, since: str, until: str, limit: int) -> list[AuditEntry]:
        """The newest entries of a plant from one time to another, the newest first.

        Times have no index. They follow the order of the entries, up to how far the clocks of
        servers differ (at most `CLOCKS`), so that both ends are found by halving the log.
        """
        after, before = (
            self._first_from(plant, since, -CLOCKS),
            self._first_from(plant, until, CLOCKS),
        )
        query = select(t.audit).where(
            t.audit.c.plant == plant,
            t.audit.c.sequence.between(after, before),
            t.audit.c.at >= since,
            t.audit.c.at <= until,
        )
        return self._all(query.order_by(t.audit.c.sequence.desc()).limit(limit))

    def _first_from(self, plant: str, at: str, shift: timedelta) -> int:
        """The sequence from which on all entries of a plant are from a time, plus a shift, or
        later, if their times follow their order."""
        shifted = time_text(datetime.fromisoformat(at) + shift)
        first, last = 1, self.size() + 1
        while first < last:
            middle = (first + last) // 2
            next_one = self._connection.execute(
                _NEXT, {"of_plant": plant, "from_sequence": middle}
            ).first()
            if next_one is not None and next_one.at < shifted:
                first = next_one.sequence + 1
            else:
                last = middle
        return first

    def first_entry(self, subject: str, kind: str) -> AuditEntry | None:
        """The first entry of a kind on a subject."""
        return self._gateway.one(
            AuditEntry, t.audit, _FIRST, {"of_subject": subject, "of_kind": kind}
        )

    def positions(self, plant: str, kind: str, subjects: Sequence[str]) -> dict[str, int]:
        """The sequence of the first entry of a kind on each of these subjects of a plant. A subject
        that was imported has no such entry, and is left out."""
        query = (
            select(t.audit.c.subject, func.min(t.audit.c.sequence))
            .where(
                t.audit.c.plant == plant,
                t.audit.c.kind == kind,
                t.audit.c.subject.in_(bindparam("subjects", expanding=True)),
            )
            .group_by(t.audit.c.subject)
        )
        rows = self._gateway.in_parts(query, "subjects", subjects)
        return {str(subject): int(sequence) for subject, sequence in rows}

    def count_beyond_end(self) -> int:
        """How many entries are stored behind the end of the log, where none can be."""
        query = select(func.count()).select_from(t.audit).where(t.audit.c.sequence > LOG_SIZE)
        return int(self._connection.scalar(query) or 0)

    def nodes(self, nodes: Iterable[Node]) -> dict[Node, bytes]:
        """The hashes of these perfect subtrees. Those that the tree does not have yet are left
        out."""
        numbers = [number_of(node) for node in set(nodes)]
        rows = self._connection.execute(_NODES, {"nodes": numbers})
        return {node_of(row.node): bytes(row.hash) for row in rows}

    def tile(self, level: int, first: int, count: int) -> list[bytes]:
        """The hashes of neighbouring subtrees of one level in order, fewer where the tree ends."""
        node, begin = t.audit_tree.c.node, number_of((level, first))
        query = select(t.audit_tree.c.hash).where(node >= begin, node < begin + count)
        return [bytes(digest) for digest in self._connection.scalars(query.order_by(node))]

    def signing_keys(self) -> list[AuditKey]:
        """The public keys under which the log was signed in order. The last one signs now."""
        query = select(t.audit_key.c.verifier, t.audit_key.c.endorsement).order_by(t.audit_key.c.id)
        rows = self._connection.execute(query)
        return [AuditKey(verifier=row.verifier, endorsement=row.endorsement) for row in rows]

    def add_key(self, key: AuditKey) -> None:
        """Add the public key that signs the log from now on."""
        self._gateway.add(t.audit_key, {"id": 1 + len(self.signing_keys()), **values_of(key)})

    def _all(self, query: Select[Any]) -> list[AuditEntry]:
        return self._gateway.all(AuditEntry, t.audit, query)


def _of(query: Select[Any], plant: str | None, project: str | None) -> Select[Any]:
    if project is not None:
        of_project = select(t.plants.c.name).where(t.plants.c.project == project)
        query = query.where(t.audit.c.plant.in_(of_project))
    return query if plant is None else query.where(t.audit.c.plant == plant)
