"""Routes of monitors, what they saw, and alarms."""

from __future__ import annotations

from dataclasses import asdict
from typing import Annotated

from fastapi import Path, Query

from trueup_service.actions import find
from trueup_service.actions.alarms import close_alarm
from trueup_service.actions.idempotency import once
from trueup_service.actor_context import END_OF_TIME
from trueup_service.http.dependencies import (
    BeforeTime,
    Digest,
    IdempotencyKey,
    Limit,
    PlantName,
    RequestContext,
    RequestParts,
)
from trueup_service.http.guard import guarded
from trueup_service.http.schemas.monitors import Alarm, Closing, Monitor, MonitorState, Watch
from trueup_service.http.schemas.wire import Page, page
from trueup_service.registry.transaction import reading

router = guarded("/v1/plants/{plant}", ["monitors"])
AlarmId = Annotated[str, Path(pattern=r"^[0-9a-f]{32}$")]
CALIBRATE = (
    "Submit a job of kind `calibrate`: healthy episodes of the role reference say what is normal."
)


@router.get("/monitor", summary="Whether the model that serves is watched")
def state(parts: RequestParts, plant: PlantName) -> MonitorState:
    with reading(parts.database) as tx:
        serving, watching, alarm = (
            find.serving(tx, plant).artifact,
            tx.watches.current(plant),
            tx.alarms.open(plant),
        )
        monitor = None if watching is None else tx.monitors.get(plant, watching.monitor)
    watches = monitor is not None and monitor.artifact == serving
    hint = (
        ""
        if watches
        else ("The monitor is of another model. " if monitor else "Nobody watches. ") + CALIBRATE
    )
    return MonitorState(
        plant=plant,
        serving=serving,
        monitor=monitor and monitor.digest,
        watches=watches,
        episodes=watching.sequence if watching else 0,
        alarm=None if alarm is None else Alarm.model_validate(alarm),
        hint=hint,
    )


@router.get("/monitors", summary="List monitors, the newest first")
def list_monitors(
    parts: RequestParts, plant: PlantName, before: BeforeTime = END_OF_TIME, limit: Limit = 100
) -> Page[Monitor]:
    with reading(parts.database) as tx:
        find.plant_digest(tx, plant)
        monitors = tx.monitors.page(plant, before, limit)
    return page(Monitor, monitors, limit, "created_at")


@router.get("/monitors/{digest}", summary="Get a monitor with its calibration")
def get_monitor(parts: RequestParts, plant: PlantName, digest: Digest) -> Monitor:
    with reading(parts.database) as tx:
        return Monitor.model_validate(find.monitor(tx, plant, digest))


@router.get("/monitors/{digest}/watches", summary="What a monitor saw, episode by episode")
def list_watches(
    parts: RequestParts,
    plant: PlantName,
    digest: Digest,
    after: Annotated[int, Query(ge=0, le=2**31 - 1, description="sequence")] = 0,
    limit: Limit = 100,
) -> Page[Watch]:
    with reading(parts.database) as tx:
        find.monitor(tx, plant, digest)
        watches = tx.watches.page(plant, digest, after, limit)
    return page(Watch, watches, limit, "sequence")


@router.get("/alarms", summary="List alarms, the newest first")
def list_alarms(
    parts: RequestParts, plant: PlantName, before: BeforeTime = END_OF_TIME, limit: Limit = 100
) -> Page[Alarm]:
    with reading(parts.database) as tx:
        find.plant_digest(tx, plant)
        alarms = tx.alarms.page(plant, before, limit)
    return page(Alarm, alarms, limit, "raised_at")


@router.get(
    "/alarms/{alarm}", summary="Get an alarm: what changed, and the diagnosis that it opened"
)
def get_alarm(parts: RequestParts, plant: PlantName, alarm: AlarmId) -> Alarm:
    with reading(parts.database) as tx:
        return Alarm.model_validate(find.alarm(tx, plant, alarm))


@router.post("/alarms/{alarm}/close", summary="Close an alarm, and say why")
def close(
    parts: RequestParts,
    context: RequestContext,
    plant: PlantName,
    alarm: AlarmId,
    closing: Closing,
    key: IdempotencyKey = None,
) -> Alarm:
    """After that the next alarm may be raised."""
    closed = parts.writer.run(
        once(
            context,
            f"alarms/{alarm}",
            key,
            closing.model_dump(),
            lambda tx: asdict(close_alarm(tx, plant, alarm, closing.because, context)),
        )
    )
    return Alarm(**closed)
