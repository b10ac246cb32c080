"""Monitors, what they watch and have seen, and the alarms that were raised."""

from __future__ import annotations

from collections.abc import Sequence

from sqlalchemy import bindparam, func, select, update

from trueup.canonical import Json
from trueup_service.registry import tables as t
from trueup_service.registry.records import AlarmRecord, MonitorRecord, Watch, Watching
from trueup_service.registry.repository import Repository, values_of
from trueup_service.registry.row_format import document_text

_OPEN = (
    select(t.alarms)
    .where(t.alarms.c.plant == bindparam("plant"), t.alarms.c.closed_at.is_(None))
    .order_by(t.alarms.c.raised_at)
    .limit(1)
)


class Monitors(Repository[MonitorRecord]):
    """Calibrated monitors."""

    table, record = t.monitors, MonitorRecord

    def get(self, plant: str, digest: str) -> MonitorRecord | None:
        """A monitor of a plant by its digest."""
        return self._by(plant=plant, digest=digest)

    def page(self, plant: str, before: str, limit: int) -> list[MonitorRecord]:
        """Monitors made before a time, the newest first."""
        of = t.monitors.c
        return self._newest(of.created_at, of.digest, before, limit, of.plant == plant)


class Watches(Repository[Watch]):
    """Which monitor watches each plant, and what it saw in each episode."""

    table, record = t.watches, Watch

    def current(self, plant: str) -> Watching | None:
        """Which monitor watches a plant, and how far it has come."""
        query = select(t.watching).where(t.watching.c.plant == plant)
        return self._gateway.one(Watching, t.watching, query, {})

    def page(self, plant: str, monitor: str, after: int, limit: int) -> list[Watch]:
        """What a monitor saw, episode by episode, from behind a sequence number."""
        of = t.watches.c
        of_monitor = of.plant == plant, of.monitor == monitor
        return self._page(of.sequence, after, limit, *of_monitor)

    def last_sequence(self, plant: str, monitor: str) -> int:
        """How many episodes a monitor has seen, those of earlier periods of watching included."""
        query = select(func.max(t.watches.c.sequence)).where(
            t.watches.c.plant == plant, t.watches.c.monitor == monitor
        )
        return int(self._connection.scalar(query) or 0)

    def begin(self, watching: Watching) -> None:
        """Let a monitor watch its plant from now on, in the place of any other."""
        of_plant = t.watching.c.plant == watching.plant
        replaced = self._gateway.update(
            update(t.watching),
            of_plant,
            monitor=watching.monitor,
            since=watching.since,
            sequence=watching.sequence,
            kept=document_text(watching.kept),
        )
        if not replaced:
            self._gateway.add(t.watching, values_of(watching))
        self._gateway.note_changed(t.watching, of_plant)

    def advance(self, before: Watching, kept: dict[str, Json], seen: Sequence[Watch]) -> bool:
        """Move a monitor on over what it has seen.

        Returns False, and changes nothing, where the monitor does not stand where it stood before.
        """
        of_plant = t.watching.c.plant == before.plant
        advanced = self._gateway.update(
            update(t.watching),
            of_plant,
            t.watching.c.monitor == before.monitor,
            t.watching.c.sequence == before.sequence,
            sequence=before.sequence + len(seen),
            kept=document_text(kept),
        )
        if not advanced:
            return False
        self._gateway.note_changed(t.watching, of_plant)
        for watch in seen:
            self.add(watch)
        return True


class Alarms(Repository[AlarmRecord]):
    """Alarms of plants."""

    table, record = t.alarms, AlarmRecord

    def get(self, alarm: str) -> AlarmRecord | None:
        """An alarm of any plant by its id."""
        return self._by(id=alarm)

    def page(self, plant: str, before: str, limit: int) -> list[AlarmRecord]:
        """Alarms raised before a time, the newest first."""
        of = t.alarms.c
        return self._newest(of.raised_at, of.id, before, limit, of.plant == plant)

    def open(self, plant: str) -> AlarmRecord | None:
        """The alarm of a plant that is open."""
        return self._one(_OPEN, plant=plant)

    def update(self, alarm: str, **values: str | None) -> bool:
        """Give an open alarm its diagnosis or its trial, or close it. Returns False where it is
        closed."""
        this_alarm = t.alarms.c.id == alarm
        is_open = t.alarms.c.closed_at.is_(None)
        updated = self._gateway.update(update(t.alarms), this_alarm, is_open, **values)
        if updated:
            self._gateway.note_changed(t.alarms, this_alarm)
        return updated
