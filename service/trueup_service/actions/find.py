"""Find what a request names, or say that it is not there."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import TypeVar

from trueup_service.actions.stamp import time_text
from trueup_service.errors import NotFound
from trueup_service.registry.records import (
    AlarmRecord,
    ArtifactRecord,
    ChannelMove,
    ChannelRecord,
    DecisionRecord,
    EpisodeRecord,
    GateRecord,
    JobRecord,
    MonitorRecord,
    Move,
    OutputRecord,
    PlantRecord,
    ProjectRecord,
    TokenRecord,
)
from trueup_service.registry.store import Reader

# kinds of jobs that read episodes
PURPOSES = (
    "fit",
    "gate",
    "diagnose",
    "blindtrial",
    "calibrate",
    "watch",
    "validate",
    "recompute",
    "compare",
)
T = TypeVar("T")


def plant(reader: Reader, name: str) -> PlantRecord:
    return _found(reader.plant(name), "plant", name)


def plant_digest(reader: Reader, name: str) -> str:
    return _found(reader.plant_digest(name), "plant", name)


def project(reader: Reader, name: str) -> ProjectRecord:
    return _found(reader.project(name), "project", name)


def token(reader: Reader, prefix: str) -> TokenRecord:
    return _found(reader.token(prefix), "token", prefix)


def episode(reader: Reader, plant: str, digest: str) -> EpisodeRecord:
    return _found(reader.episode(plant, digest), "episode", digest)


def uses(reader: Reader, digest: str) -> dict[str, int]:
    """How many jobs of each kind read an episode."""
    return {purpose: reader.uses(digest, purpose) for purpose in PURPOSES}


def served_during(reader: Reader, episode: EpisodeRecord) -> list[Move]:
    """Every position of the pointer that was live at some time of the recording."""
    begin, end = (
        time_text(datetime.fromtimestamp(ns / 1e9, UTC))
        for ns in (episode.start_ns, episode.end_ns)
    )
    first, last = reader.served_at(episode.plant, begin), reader.served_at(episode.plant, end)
    if last is None:
        return []
    before = first.generation if first else 0
    return reader.moves(episode.plant, max(before - 1, 0), last.generation - max(before - 1, 0))


def artifact(reader: Reader, plant: str, digest: str) -> ArtifactRecord:
    return _found(reader.artifact(plant, digest), "artifact", digest)


def version(reader: Reader, plant: str, version: int) -> ArtifactRecord:
    return _found(reader.artifact_version(plant, version), "version", str(version))


def gate(reader: Reader, plant: str, digest: str) -> GateRecord:
    return _found(reader.gate(plant, digest), "gate", digest)


def job(reader: Reader, name: str) -> JobRecord:
    return _found(reader.job(name), "job", name)


def output(reader: Reader, job: str, name: str) -> OutputRecord:
    return _found(reader.output(job, name), "output", name)


def monitor(reader: Reader, plant: str, digest: str) -> MonitorRecord:
    return _found(reader.monitor(plant, digest), "monitor", digest)


def alarm(reader: Reader, plant: str, name: str) -> AlarmRecord:
    found = reader.alarm(name)
    return _found(found if found is not None and found.plant == plant else None, "alarm", name)


def channel(reader: Reader, plant: str, name: str) -> ChannelRecord:
    return _found(reader.channel(plant, name), "channel", name)


def channel_move(reader: Reader, plant: str, name: str) -> ChannelMove:
    channel(reader, plant, name)
    found = reader.channel_move(plant, name)
    if found is None:
        raise NotFound(
            f"channel {name!r} serves nothing yet",
            noun="position",
            name=name,
            hint="Move it to an artifact that serves.",
        )
    return found


def any_decision(reader: Reader, digest: str) -> DecisionRecord:
    return _found(reader.decision(digest), "decision", digest)


def decision(reader: Reader, plant: str, digest: str) -> DecisionRecord:
    found = any_decision(reader, digest)
    return _found(found if found.plant == plant else None, "decision", digest)


def serving(reader: Reader, plant: str) -> Move:
    return _found(reader.serving(plant), "plant", plant)


def _found(record: T | None, noun: str, name: str) -> T:
    if record is None:
        raise missing(noun, name)
    return record


def missing(noun: str, name: str) -> NotFound:
    """The one answer for what is not here."""
    return NotFound(f"there is no {noun} {name!r} here", noun=noun, name=name)
