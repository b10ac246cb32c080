"""Raise an alarm, of which a plant has one open at a time, and close it."""

from __future__ import annotations

from typing import Any

from trueup.canonical import Json
from trueup.ledger.operation import Operation
from trueup_service.actions import find
from trueup_service.actor_context import ActorContext
from trueup_service.errors import Conflict
from trueup_service.registry.records import AlarmRecord
from trueup_service.registry.transaction import Transaction


def raise_alarm(
    tx: Transaction,
    name: str,
    plant: str,
    monitor: str | None,
    artifact: str,
    change: dict[str, Any],
    context: ActorContext,
) -> AlarmRecord | None:
    """Raise an alarm on the episode and with the document of `change`. Returns None, and changes
    nothing, where another alarm is open or the artifact does not serve any more."""
    if tx.alarms.open(plant) is not None or find.serving(tx, plant).artifact != artifact:
        return None
    raised = AlarmRecord(
        id=name,
        plant=plant,
        monitor=monitor,
        artifact=artifact,
        episode=change["episode"],
        document=change["document"],
        job=None,
        trial=None,
        raised_at=context.now,
        closed_at=None,
        closed_by=None,
        closed_because=None,
    )
    tx.alarms.add(raised)
    facts: dict[str, Json] = {
        "operation": Operation.MONITORING,
        "monitor": monitor,
        "episode": raised.episode,
        "alarm": raised.document,
    }
    tx.log.append(context, "alarm:raised", plant=plant, subject=name, facts=facts)
    return raised


def follow_alarm(
    tx: Transaction, alarm: AlarmRecord, context: ActorContext, **jobs: str | None
) -> None:
    """Record which diagnosis an alarm opened, or which trial judges the model that the diagnosis
    made."""
    tx.alarms.update(alarm.id, **jobs)
    facts: dict[str, Json] = {"operation": Operation.MONITORING, **jobs}
    tx.log.append(context, "alarm:followed", plant=alarm.plant, subject=alarm.id, facts=facts)


def close_alarm(
    tx: Transaction, plant: str, alarm: str, because: str, context: ActorContext
) -> AlarmRecord:
    """Close an alarm with a reason. Raises NotFound, and Conflict where it is closed already."""
    tx.plants.lock(plant)
    open_alarm = find.alarm(tx, plant, alarm)
    if not tx.alarms.update(
        alarm, closed_at=context.now, closed_by=context.actor, closed_because=because
    ):
        raise Conflict(
            "the alarm is closed already",
            hint="Nothing is left to do.",
            closed_at=open_alarm.closed_at,
        )
    facts: dict[str, Json] = {"operation": Operation.MONITORING, "because": because}
    tx.log.append(context, "alarm:closed", plant=plant, subject=alarm, facts=facts)
    return find.alarm(tx, plant, alarm)
