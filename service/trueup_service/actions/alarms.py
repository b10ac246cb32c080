"""Raise an alarm, one at a time, and close it."""

from __future__ import annotations

from typing import Any

from trueup.canonical import Json
from trueup.ledger.operation import Operation
from trueup_service.actions import find
from trueup_service.actions.stamp import Stamp
from trueup_service.errors import Conflict
from trueup_service.registry.records import AlarmRecord
from trueup_service.registry.store import Writer


def raise_alarm(
    writer: Writer,
    name: str,
    plant: str,
    monitor: str | None,
    artifact: str,
    found: dict[str, Any],
    stamp: Stamp,
) -> AlarmRecord | None:
    """The alarm; None, and nothing is done, while another is open, or if it is about a model that
    serves no more."""
    if writer.open_alarm(plant) is not None or find.serving(writer, plant).artifact != artifact:
        return None
    raised = AlarmRecord(
        name,
        plant,
        monitor,
        artifact,
        found["episode"],
        found["document"],
        None,
        None,
        stamp.now,
        None,
        None,
        None,
    )
    writer.add_alarm(raised)
    facts: dict[str, Json] = {
        "operation": Operation.MONITORING,
        "monitor": monitor,
        "episode": raised.episode,
        "alarm": raised.document,
    }
    writer.append_audit(
        at=stamp.now, kind="alarm:raised", actor=stamp.actor, plant=plant, subject=name, facts=facts
    )
    return raised


def follow_alarm(writer: Writer, alarm: AlarmRecord, stamp: Stamp, **jobs: str | None) -> None:
    """Note which diagnosis an alarm opened, and which trial of what that made."""
    writer.update_alarm(alarm.id, **jobs)
    facts: dict[str, Json] = {"operation": Operation.MONITORING, **jobs}
    writer.append_audit(
        at=stamp.now,
        kind="alarm:followed",
        actor=stamp.actor,
        plant=alarm.plant,
        subject=alarm.id,
        facts=facts,
    )


def close_alarm(writer: Writer, plant: str, alarm: str, because: str, stamp: Stamp) -> AlarmRecord:
    """Close an alarm, and say why. Raises NotFound, Conflict if it is closed already."""
    writer.lock_plant(plant)
    found = find.alarm(writer, plant, alarm)
    if not writer.update_alarm(
        alarm, closed_at=stamp.now, closed_by=stamp.actor, closed_because=because
    ):
        raise Conflict(
            "the alarm is closed already", hint="Nothing is left to do.", closed_at=found.closed_at
        )
    facts: dict[str, Json] = {"operation": Operation.MONITORING, "because": because}
    writer.append_audit(
        at=stamp.now,
        kind="alarm:closed",
        actor=stamp.actor,
        plant=plant,
        subject=alarm,
        facts=facts,
    )
    return find.alarm(writer, plant, alarm)
