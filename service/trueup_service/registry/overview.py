"""Overview of plants: one line for each, read with a few statements for a whole page."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass

from sqlalchemy import ColumnElement, select

from trueup_service.registry import tables as t
from trueup_service.registry.audit_log import ESCAPE
from trueup_service.registry.label_record import Labelled, LabelRecord
from trueup_service.registry.labels import has_tag
from trueup_service.registry.transaction import ReadTransaction

WATCHED = 40  # episodes of a gap


@dataclass(frozen=True, slots=True)
class PlantLine:
    """One plant in the overview: what serves since when, the gap in the last episodes, the last
    alarm and the last decision.

    `gap` has the RMS error of each watched episode, the oldest first, in healthy spreads of the
    model that serves (1 is healthy). It is empty where no monitor watches.
    """

    name: str
    version: int
    generation: int
    since: str
    gap: tuple[float, ...]
    alarm: str | None
    alarm_open: bool
    decision: str | None
    decided_at: str | None
    accepted: bool | None
    label: LabelRecord | None


def plant_lines(
    tx: ReadTransaction,
    after: str,
    limit: int,
    *,
    of: str | None,
    project: str | None,
    containing: str = "",
    tag: str = "",
    alarmed: bool = False,
) -> list[PlantLine]:
    """Plants by name from behind one: all of them, those of a project, or the plant `of` alone;
    those whose name or label contains some text, that have a tag, or whose alarm is open."""
    last = (
        select(t.alarms.c.raised_at)
        .where(t.alarms.c.plant == t.plants.c.name)
        .order_by(t.alarms.c.raised_at.desc())
        .limit(1)
    )
    is_open = (
        select(t.alarms.c.id)
        .where(t.alarms.c.plant == t.plants.c.name, t.alarms.c.closed_at.is_(None))
        .exists()
    )
    decided = t.decisions.alias()
    newest = (
        select(t.decisions.c.digest)
        .where(t.decisions.c.plant == t.plants.c.name)
        .order_by(t.decisions.c.created_at.desc(), t.decisions.c.digest)
        .limit(1)
        .scalar_subquery()
    )
    names = select(t.plants.c.name).where(t.plants.c.name > after)
    names = names if of is None else names.where(t.plants.c.name == of)
    names = names if project is None else names.where(t.plants.c.project == project)
    if containing:
        labelled = _labelled(t.labels.c.name.icontains(containing, autoescape=True, escape=ESCAPE))
        named = t.plants.c.name.contains(containing, autoescape=True, escape=ESCAPE)
        names = names.where(named | labelled)
    names = names if not tag else names.where(_labelled(has_tag(tag)))
    names = names if not alarmed else names.where(is_open)
    page = names.order_by(t.plants.c.name).limit(limit).subquery()
    query = (
        select(
            t.plants.c.name,
            t.moves.c.version,
            t.moves.c.generation,
            t.moves.c.at.label("since"),
            last.scalar_subquery().label("alarm"),
            is_open.label("alarm_open"),
            decided.c.digest.label("decision"),
            decided.c.created_at.label("decided_at"),
            decided.c.accepted,
        )
        .join(page, page.c.name == t.plants.c.name)
        .join(t.serving, t.serving.c.plant == t.plants.c.name)
        .join(
            t.moves,
            (t.moves.c.plant == t.serving.c.plant)
            & (t.moves.c.generation == t.serving.c.generation),
        )
        .outerjoin(decided, decided.c.digest == newest)
        .order_by(t.plants.c.name)
    )
    rows = [dict(row) for row in tx.connection.execute(query).mappings()]
    listed = [row["name"] for row in rows]
    gaps, labels = gaps_of(tx, listed), tx.labels.of_plants(listed)
    return [
        PlantLine(gap=gaps.get(row["name"], ()), label=labels.get(row["name"]), **row)
        for row in rows
    ]


def _labelled(condition: ColumnElement[bool]) -> ColumnElement[bool]:
    """The condition that a plant has a label which meets one."""
    of = t.labels.c
    return t.plants.c.name.in_(select(of.plant).where(of.kind == Labelled.PLANT, condition))


def gaps_of(tx: ReadTransaction, plants: Sequence[str]) -> dict[str, tuple[float, ...]]:
    """The RMS error of the model that serves over the channels of each of the last WATCHED
    episodes, the oldest first, in healthy spreads, for each plant whose monitor watches."""
    query = (
        select(t.watches.c.plant, t.watches.c.seen)
        .join(
            t.watching,
            (t.watching.c.plant == t.watches.c.plant)
            & (t.watching.c.monitor == t.watches.c.monitor),
        )
        .where(
            t.watching.c.plant.in_(plants), t.watches.c.sequence > t.watching.c.sequence - WATCHED
        )
        .order_by(t.watches.c.plant, t.watches.c.sequence)
    )
    gaps: dict[str, list[float]] = {}
    for row in tx.connection.execute(query):
        channels = json.loads(row.seen).get("channels", {}).values()
        errors = [c["rms"] for c in channels if isinstance(c["rms"], int | float)]
        if errors:
            gaps.setdefault(row.plant, []).append((sum(e * e for e in errors) / len(errors)) ** 0.5)
    return {plant: tuple(errors) for plant, errors in gaps.items()}
