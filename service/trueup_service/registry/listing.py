"""Lists of what a plant has, with labels: sorted, filtered, a page at a time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from sqlalchemy import ColumnElement, Select, Table, func, select

from trueup_service.registry import tables as t
from trueup_service.registry.audit_log import ESCAPE
from trueup_service.registry.label_record import Labelled, LabelRecord
from trueup_service.registry.labels import has_tag
from trueup_service.registry.records import ArtifactRecord, DecisionRecord, EpisodeRecord
from trueup_service.registry.row_format import record_from_row
from trueup_service.registry.transaction import ReadTransaction

LINES = 50  # of a page


@dataclass(frozen=True, slots=True)
class Listed:
    """What is listed of a kind: its table and records, the columns that it can be sorted by, the
    first one by default, and the one whose values select some."""

    table: Table
    record: type[Any]
    sorts: Mapping[str, ColumnElement[Any]]
    selecting: ColumnElement[Any]


_EPISODES, _VERSIONS, _DECISIONS = t.episodes.c, t.artifacts.c, t.decisions.c
LISTED: Mapping[Labelled, Listed] = {
    Labelled.EPISODE: Listed(
        t.episodes,
        EpisodeRecord,
        {
            "recorded": _EPISODES.start_ns,
            "uploaded": _EPISODES.created_at,
            "duration": _EPISODES.end_ns - _EPISODES.start_ns,
            "role": _EPISODES.role,
        },
        _EPISODES.role,
    ),
    Labelled.VERSION: Listed(
        t.artifacts,
        ArtifactRecord,
        {"version": _VERSIONS.version, "kind": _VERSIONS.kind},
        _VERSIONS.kind,
    ),
    Labelled.DECISION: Listed(
        t.decisions,
        DecisionRecord,
        {"decided": _DECISIONS.created_at, "accepted": _DECISIONS.accepted},
        _DECISIONS.accepted,
    ),
}
NAME = "name"  # by which everything can be sorted


@dataclass(frozen=True, slots=True)
class Wanted:
    """Which lines of a list are wanted: sorted by what, a minus before it for the other direction;
    whose name or digest has a text, with a tag, of one value; and which page of them, from 1."""

    sort: str
    containing: str = ""
    tag: str = ""
    only: Any = None
    page: int = 1


@dataclass(frozen=True, slots=True)
class Line:
    """A record, and its label if it has one."""

    record: Any
    label: LabelRecord | None


def lines(
    tx: ReadTransaction, plant: str, kind: Labelled, wanted: Wanted, limit: int = LINES
) -> tuple[list[Line], int]:
    """The lines of a page of at most `limit`, and how many there are on all of them. Raises
    KeyError where nothing can be sorted by that."""
    listed = LISTED[kind]
    of = listed.table.c
    matching = _matching(plant, kind, listed, wanted)
    count = tx.connection.scalar(matching.with_only_columns(func.count())) or 0
    ordered = _sorted(matching, kind, listed, wanted.sort)
    digests = list(tx.connection.scalars(ordered.limit(limit).offset(limit * (wanted.page - 1))))
    # Rows are wide: only those that are shown are read.
    shown = select(listed.table).where(of.plant == plant, of.digest.in_(digests))
    rows = tx.connection.execute(shown).mappings()
    records = {row["digest"]: record_from_row(listed.record, listed.table, row) for row in rows}
    labels = tx.labels.of(plant, kind, digests)
    return [Line(records[d], labels.get(d)) for d in digests], int(count)


def _matching(plant: str, kind: Labelled, listed: Listed, wanted: Wanted) -> Select[Any]:
    """The digests of what matches."""
    of, label = listed.table.c, t.labels.c
    query = select(of.digest).where(of.plant == plant)
    labelled = select(label.subject).where(label.plant == plant, label.kind == kind)
    if wanted.containing:
        named = label.name.icontains(wanted.containing, autoescape=True, escape=ESCAPE)
        beginning = of.digest.startswith(wanted.containing.lower(), autoescape=True)
        query = query.where(of.digest.in_(labelled.where(named)) | beginning)
    if wanted.tag:
        query = query.where(of.digest.in_(labelled.where(has_tag(wanted.tag))))
    return query if wanted.only is None else query.where(listed.selecting == wanted.only)


def _sorted(query: Select[Any], kind: Labelled, listed: Listed, sort: str) -> Select[Any]:
    """The digests in the order of what they are sorted by."""
    of, label = listed.table.c, t.labels.c
    name = sort.removeprefix("-")
    if name == NAME:
        its_own = (label.plant == of.plant) & (label.kind == kind) & (label.subject == of.digest)
        query = query.outerjoin(t.labels, its_own)
    by = {**listed.sorts, NAME: func.coalesce(label.name, of.digest)}[name]
    return query.order_by(by.desc() if sort.startswith("-") else by, of.digest)
