"""Record what a monitor saw in new episodes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from trueup.canonical import Json
from trueup_service.actions import find
from trueup_service.actions.alarms import raise_alarm
from trueup_service.actor_context import ActorContext
from trueup_service.registry.records import Watch, Watching
from trueup_service.registry.transaction import Transaction


@dataclass(frozen=True, slots=True)
class Followed:
    """The result of following episodes with a monitor that stood at `before`: the state that its
    detectors keep, what was seen, and the first alarm.

    `alarm` has the `episode` on which it was raised, and the `document` that says what changed
    since when.
    """

    before: Watching
    kept: dict[str, Json]
    seen: Sequence[Watch]
    alarm: dict[str, Any] | None


def record_watch(tx: Transaction, followed: Followed, alarm_id: str, context: ActorContext) -> bool:
    """Move a monitor on. Returns False, and changes nothing, where another job has moved it."""
    before, alarm = followed.before, followed.alarm
    tx.plants.lock(before.plant)
    if not tx.watches.advance(before, followed.kept, followed.seen):
        return False
    if alarm is not None:
        artifact = find.monitor(tx, before.plant, before.monitor).artifact
        raise_alarm(tx, alarm_id, before.plant, before.monitor, artifact, alarm, context)
    return True
