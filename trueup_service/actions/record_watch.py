"""Record what a monitor saw, and raise an alarm: one at a time, which opens a diagnosis as soon as there is something to diagnose."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from trueup.canonical import Json
from trueup.episode.role import Role
from trueup_service.actions import find
from trueup_service.actions.stamp import Stamp
from trueup_service.actions.submit_job import submit_diagnosis
from trueup_service.errors import Conflict
from trueup_service.jobs import JobQueue
from trueup_service.registry.records import AlarmRecord, Watch, Watching
from trueup_service.registry.store import Writer

DIAGNOSED = (Role.ADAPTATION, Role.VALIDATION)
NewId = Callable[[], str]


@dataclass(frozen=True, slots=True)
class Followed:
    """What came of following episodes `before` which the monitor stood: what its detectors keep, what was seen, and the first alarm.

    `alarm` has the `episode` on which it was raised, and the `document` that says what changed since when.
    """

    before: Watching
    kept: dict[str, Json]
    seen: Sequence[Watch]
    alarm: dict[str, Any] | None


def record_watch(writer: Writer, queue: JobQueue, followed: Followed, new: NewId, stamp: Stamp) -> bool:
    """Move the monitor on; False, and nothing is done, if another job has moved it. While an alarm is open no other is raised."""
    before, alarm = followed.before, followed.alarm
    writer.lock_plant(before.plant)
    if not writer.advance(before, followed.kept, followed.seen):
        return False
    opened = writer.open_alarm(before.plant)
    if opened is None and alarm is not None:
        artifact = find.monitor(writer, before.plant, before.monitor).artifact
        opened = AlarmRecord(
            new(), before.plant, before.monitor, artifact, alarm["episode"], alarm["document"], None, stamp.now, None, None, None
        )
        writer.add_alarm(opened)
        facts: dict[str, Json] = {"monitor": before.monitor, "episode": opened.episode, "alarm": opened.document}
        writer.append_audit(at=stamp.now, kind="alarm:raised", actor=stamp.actor, plant=before.plant, subject=opened.id, facts=facts)
    if opened is not None and opened.job is None:
        open_diagnosis(writer, queue, opened, new(), stamp)
    return True


def open_diagnosis(writer: Writer, queue: JobQueue, alarm: AlarmRecord, job: str, stamp: Stamp) -> None:
    """Diagnose what was recorded since the change began, once there are episodes to fit and to compare on."""
    document: dict[str, Any] = alarm.document
    found = [e for e in writer.episodes_of_role(alarm.plant, DIAGNOSED) if e.start_ns >= int(document["since_ns"])]
    if {e.role for e in found} == set(DIAGNOSED):
        submit_diagnosis(writer, queue, job, alarm.plant, {"episodes": [e.digest for e in found], "seed": 0}, stamp)
        writer.update_alarm(alarm.id, job=job)


def close_alarm(writer: Writer, plant: str, alarm: str, because: str, stamp: Stamp) -> AlarmRecord:
    """Close an alarm, and say why. Raises NotFound, Conflict if it is closed already."""
    found = find.alarm(writer, plant, alarm)
    if not writer.update_alarm(alarm, closed_at=stamp.now, closed_by=stamp.actor, closed_because=because):
        raise Conflict("the alarm is closed already", hint="Nothing is left to do.", closed_at=found.closed_at)
    writer.append_audit(at=stamp.now, kind="alarm:closed", actor=stamp.actor, plant=plant, subject=alarm, facts={"because": because})
    return find.alarm(writer, plant, alarm)
