"""Lists of what a plant has, with labels: sorted, filtered, a page at a time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from sqlalchemy import ColumnElement, Select, Table, func, select
from sqlalchemy.sql.base import ReadOnlyColumnCollection

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
    name = func.coalesce(t.labels.c.name, of.digest)
    by = {**listed.sorts, NAME: name}[wanted.sort.removeprefix("-")]
    matching = _matching(plant, kind, listed, wanted)
    count = tx.connection.scalar(matching.with_only_columns(func.count())) or 0
    if by is name and not _by_label(wanted):  # the count needs no label then
        matching = _with_label(matching, kind, of)
    ordered = matching.order_by(by.desc() if wanted.sort.startswith("-") else by, of.digest)
    digests = list(tx.connection.scalars(ordered.limit(limit).offset(limit * (wanted.page - 1))))
    # Rows are wide: only those that are shown are read.
    rows = tx.connection.execute(
        select(listed.table).where(of.plant == plant, of.digest.in_(digests))
    )
    records = {
        r["digest"]: record_from_row(listed.record, listed.table, r) for r in rows.mappings()
    }
    labels = tx.labels.of(plant, kind, digests)
    return [Line(records[d], labels.get(d)) for d in digests], int(count)


def _by_label(wanted: Wanted) -> bool:
    """Whether lines are chosen by their labels."""
    return bool(wanted.containing or wanted.tag)


def _with_label(
    query: Select[Any], kind: Labelled, of: ReadOnlyColumnCollection[str, Any]
) -> Select[Any]:
    return query.outerjoin(
        t.labels,
        (t.labels.c.plant == of.plant)
        & (t.labels.c.kind == kind)
        & (t.labels.c.subject == of.digest),
    )


def _matching(plant: str, kind: Labelled, listed: Listed, wanted: Wanted) -> Select[Any]:
    """The digests of what matches."""
    of = listed.table.c
    query = select(of.digest).where(of.plant == plant)
    if _by_label(wanted):
        query = _with_label(query, kind, of)
    if wanted.containing:
        named = t.labels.c.name.icontains(wanted.containing, autoescape=True, escape=ESCAPE)
        query = query.where(
            named | of.digest.startswith(wanted.containing.lower(), autoescape=True)
        )
    if wanted.tag:
        query = query.where(has_tag(wanted.tag))
    return query if wanted.only is None else query.where(listed.selecting == wanted.only)
