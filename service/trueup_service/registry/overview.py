"""Overview: what somebody who looks at all plants, or at one, wants to see at a glance, in a few
statements for a whole page."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from sqlalchemy import Connection, Select, select

from trueup.ledger.audit import AuditEntry
from trueup_service.registry import tables as t
from trueup_service.registry.records import JobRecord
from trueup_service.registry.store import record_of

WATCHED = 40  # episodes of a gap's line
ESCAPE = "\\"
LOOKED_THROUGH = 200  # jobs of a kind, the newest


@dataclass(frozen=True, slots=True)
class PlantLine:
    """A plant at a glance: what serves since when, how large the gap was in the last episodes
    (None: nobody watches), the last alarm and the last decision.

    `gap` is in the spreads that are healthy for the model that serves: 1 is healthy.
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


def plant_lines(
    connection: Connection,
    after: str,
    limit: int,
    *,
    of: str | None,
    project: str | None,
    containing: str,
) -> list[PlantLine]:
    """Plants by name from behind one, all or those of a project or the plant `of`, whose name
    contains some text."""
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
    names = (
        names
        if not containing
        else names.where(t.plants.c.name.contains(containing, autoescape=True, escape=ESCAPE))
    )
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
    found = [dict(row) for row in connection.execute(query).mappings()]
    gaps = gaps_of(connection, [row["name"] for row in found])
    return [PlantLine(gap=gaps.get(row["name"], ()), **row) for row in found]


def gaps_of(connection: Connection, plants: Sequence[str]) -> dict[str, tuple[float, ...]]:
    """The error of the model that serves in the last episodes, the oldest first, where its monitor
    watches."""
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
    for row in connection.execute(query):
        channels = json.loads(row.seen).get("channels", {}).values()
        errors = [c["rms"] for c in channels if isinstance(c["rms"], int | float)]
        if errors:
            gaps.setdefault(row.plant, []).append((sum(e * e for e in errors) / len(errors)) ** 0.5)
    return {plant: tuple(found) for plant, found in gaps.items()}


def last_entries(
    connection: Connection,
    before: int,
    limit: int,
    *,
    plant: str | None = None,
    project: str | None = None,
    kind: str = "",
) -> list[AuditEntry]:
    """Entries of the log, the newest first, before one; of all, of a plant, of a project's plants;
    of a kind or of what it begins with."""
    query = select(t.audit).where(t.audit.c.sequence < before)
    query = query if plant is None else query.where(t.audit.c.plant == plant)
    query = (
        query
        if project is None
        else query.where(
            t.audit.c.plant.in_(select(t.plants.c.name).where(t.plants.c.project == project))
        )
    )
    query = (
        query
        if not kind
        else query.where(t.audit.c.kind.startswith(kind, autoescape=True, escape=ESCAPE))
    )
    return _entries(connection, query.order_by(t.audit.c.sequence.desc()).limit(limit))


def entry_on(connection: Connection, subject: str, kind: str) -> AuditEntry | None:
    """The entry of a kind that tells of something."""
    query = (
        select(t.audit)
        .where(t.audit.c.subject == subject, t.audit.c.kind == kind)
        .order_by(t.audit.c.sequence)
        .limit(1)
    )
    return next(iter(_entries(connection, query)), None)


def _entries(connection: Connection, query: Select[Any]) -> list[AuditEntry]:
    return [record_of(AuditEntry, row) for row in connection.execute(query).mappings()]


def newest_job(
    connection: Connection, plant: str, kind: str, fits: Callable[[Mapping[str, Any]], bool]
) -> JobRecord | None:
    """The newest job of a kind whose request fits, among the last of that kind."""
    query = (
        select(t.jobs)
        .where(t.jobs.c.plant == plant, t.jobs.c.kind == kind)
        .order_by(t.jobs.c.created_at.desc())
        .limit(LOOKED_THROUGH)
    )
    found = (record_of(JobRecord, row) for row in connection.execute(query).mappings())
    return next((job for job in found if fits(job.request)), None)
