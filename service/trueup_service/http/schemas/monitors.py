"""Monitors, what they saw, and alarms, on the wire."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel, Field

from trueup_service.control_characters import LINE
from trueup_service.http.schemas.wire import Digest, FromRecord, RequestBody, Time


class Monitor(FromRecord):
    """A calibrated monitor: its detectors with their levels, and the promise that they were
    measured to keep."""

    plant: str
    digest: Digest
    artifact: Digest
    document: dict[str, Any]
    job: str | None
    created_at: Time
    created_by: str


class Watch(FromRecord):
    """What a monitor saw in one episode: the highest statistic of each detector, and the error of
    each channel in healthy spreads."""

    sequence: int
    episode: Digest
    seen: dict[str, Any]
    at: Time


class Alarm(FromRecord):
    """An alarm. `document` says which detectors alarmed, since when, and what changed. `job` is the
    diagnosis that it opened, and `trial` the trial of the model that the diagnosis made."""

    id: str
    plant: str
    monitor: Digest | None
    artifact: Digest
    episode: Digest
    document: dict[str, Any]
    job: str | None
    trial: str | None
    raised_at: Time
    closed_at: Time | None
    closed_by: str | None
    closed_because: str | None


class MonitorState(BaseModel):
    """Whether a monitor watches the model that serves. Where none was calibrated for it, `watches`
    is false and `hint` says what to do."""

    plant: str
    serving: Digest
    monitor: Digest | None
    watches: bool
    episodes: int
    alarm: Alarm | None
    hint: str


class Closing(RequestBody):
    """The reason for closing an alarm."""

    because: str = Field(min_length=1, max_length=500, pattern=LINE)
