"""Monitors: what watches a plant, what it saw, and its alarms."""

from __future__ import annotations

from dataclasses import asdict
from typing import Annotated

from fastapi import Path, Query

from trueup_service.actions import find
from trueup_service.actions.alarms import close_alarm
from trueup_service.actions.stamp import END_OF_TIME
from trueup_service.http.context import (
    Before,
    By,
    DigestPath,
    IdempotencyKey,
    Limit,
    PlantName,
    With,
    run_once,
)
from trueup_service.http.guard import guarded
from trueup_service.http.schemas import Alarm, Closing, Monitor, MonitorState, Page, Watch, page
from trueup_service.registry.store import Reader

router = guarded("/v1/plants/{plant}", ["monitors"])
AlarmId = Annotated[str, Path(pattern=r"^[0-9a-f]{32}$")]
CALIBRATE = (
    "Submit a job of kind `calibrate`: healthy episodes of the role reference say what is normal."
)


@router.get("/monitor", summary="Whether the model that serves is watched")
def state(parts: With, plant: PlantName) -> MonitorState:
    with parts.database.read() as connection:
        reader = Reader(connection)
        serving, watching, alarm = (
            find.serving(reader, plant).artifact,
            reader.watching(plant),
            reader.open_alarm(plant),
        )
        monitor = None if watching is None else reader.monitor(plant, watching.monitor)
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
    parts: With, plant: PlantName, before: Before = END_OF_TIME, limit: Limit = 100
) -> Page[Monitor]:
    with parts.database.read() as connection:
        reader = Reader(connection)
        find.plant_digest(reader, plant)
        found = reader.monitors(plant, before, limit)
    return page(Monitor, found, limit, "created_at")


@router.get("/monitors/{digest}", summary="Get a monitor with its calibration")
def get_monitor(parts: With, plant: PlantName, digest: DigestPath) -> Monitor:
    with parts.database.read() as connection:
        return Monitor.model_validate(find.monitor(Reader(connection), plant, digest))


@router.get("/monitors/{digest}/watches", summary="What a monitor saw, episode by episode")
def list_watches(
    parts: With,
    plant: PlantName,
    digest: DigestPath,
    after: Annotated[int, Query(ge=0, le=2**31 - 1, description="sequence")] = 0,
    limit: Limit = 100,
) -> Page[Watch]:
    with parts.database.read() as connection:
        reader = Reader(connection)
        find.monitor(reader, plant, digest)
        found = reader.watches(plant, digest, after, limit)
    return page(Watch, found, limit, "sequence")


@router.get("/alarms", summary="List alarms, the newest first")
def list_alarms(
    parts: With, plant: PlantName, before: Before = END_OF_TIME, limit: Limit = 100
) -> Page[Alarm]:
    with parts.database.read() as connection:
        reader = Reader(connection)
        find.plant_digest(reader, plant)
        found = reader.alarms(plant, before, limit)
    return page(Alarm, found, limit, "raised_at")


@router.get(
    "/alarms/{alarm}", summary="Get an alarm: what changed, and the diagnosis that it opened"
)
def get_alarm(parts: With, plant: PlantName, alarm: AlarmId) -> Alarm:
    with parts.database.read() as connection:
        return Alarm.model_validate(find.alarm(Reader(connection), plant, alarm))


@router.post("/alarms/{alarm}/close", summary="Close an alarm, and say why")
def close(
    parts: With,
    stamp: By,
    plant: PlantName,
    alarm: AlarmId,
    closing: Closing,
    key: IdempotencyKey = None,
) -> Alarm:
    """The next one may then be raised."""
    closed = run_once(
        parts,
        stamp,
        f"alarms/{alarm}",
        key,
        closing.model_dump(),
        lambda w: asdict(close_alarm(w, plant, alarm, closing.because, stamp)),
    )
    return Alarm(**closed)
