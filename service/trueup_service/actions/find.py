"""Look up what a request names. Each function returns the record, or raises NotFound."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime
from typing import TypeVar

from trueup_service.actor_context import time_text
from trueup_service.errors import NotFound
from trueup_service.registry.label_record import Labelled
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
    WebhookRecord,
)
from trueup_service.registry.transaction import ReadTransaction

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
    "openloop",
    "closedloop",
    "consistency",
    "randomise",
    "excite",
)
T = TypeVar("T")


def plant(tx: ReadTransaction, name: str) -> PlantRecord:
    """A plant by its name. Raises NotFound."""
    return _require(tx.plants.get(name), "plant", name)


def plant_digest(tx: ReadTransaction, name: str) -> str:
    """The digest of a plant's description. Raises NotFound."""
    return _require(tx.plants.digest(name), "plant", name)


def project(tx: ReadTransaction, name: str) -> ProjectRecord:
    """A project by its name. Raises NotFound."""
    return _require(tx.projects.get(name), "project", name)


def token(tx: ReadTransaction, prefix: str) -> TokenRecord:
    """A token by its public prefix. Raises NotFound."""
    return _require(tx.tokens.get(prefix), "token", prefix)


def webhook(tx: ReadTransaction, name: str) -> WebhookRecord:
    """A webhook by its name. Raises NotFound."""
    return _require(tx.webhooks.get(name), "webhook", name)


def episode(tx: ReadTransaction, plant: str, digest: str) -> EpisodeRecord:
    """An episode of a plant by its digest. Raises NotFound."""
    return _require(tx.episodes.get(plant, digest), "episode", digest)


def names_of_episodes(tx: ReadTransaction, plant: str, digests: Sequence[str]) -> dict[str, str]:
    """What some episodes are called, by digest: by their label, else as they were recorded; without
    those that have no name."""
    labelled = tx.labels.names(plant, Labelled.EPISODE, digests)
    return {**tx.episodes.names(plant, [d for d in digests if d not in labelled]), **labelled}


def uses(tx: ReadTransaction, digest: str) -> dict[str, int]:
    """How many jobs of each kind have read an episode."""
    return {purpose: tx.jobs.count_uses(digest, purpose) for purpose in PURPOSES}


def served_during(tx: ReadTransaction, episode: EpisodeRecord) -> list[Move]:
    """Every position of the serving pointer during a recording, in order."""
    begin, end = (
        time_text(datetime.fromtimestamp(ns / 1e9, UTC))
        for ns in (episode.start_ns, episode.end_ns)
    )
    first, last = tx.serving.at_time(episode.plant, begin), tx.serving.at_time(episode.plant, end)
    if last is None:
        return []
    before = first.generation if first else 0
    return tx.serving.history(
        episode.plant, max(before - 1, 0), last.generation - max(before - 1, 0)
    )


def artifact(tx: ReadTransaction, plant: str, digest: str) -> ArtifactRecord:
    """An artifact of a plant by its digest. Raises NotFound."""
    return _require(tx.artifacts.get(plant, digest), "artifact", digest)


def version(tx: ReadTransaction, plant: str, version: int) -> ArtifactRecord:
    """An artifact of a plant by its version. Raises NotFound."""
    return _require(tx.artifacts.by_version(plant, version), "version", str(version))


def gate(tx: ReadTransaction, plant: str, digest: str) -> GateRecord:
    """A gate of a plant by its digest. Raises NotFound."""
    return _require(tx.gates.get(plant, digest), "gate", digest)


def job(tx: ReadTransaction, name: str) -> JobRecord:
    """A job by its id. Raises NotFound."""
    return _require(tx.jobs.get(name), "job", name)


def output(tx: ReadTransaction, job: str, name: str) -> OutputRecord:
    """A file of a job by its name. Raises NotFound."""
    return _require(tx.outputs.get(job, name), "output", name)


def monitor(tx: ReadTransaction, plant: str, digest: str) -> MonitorRecord:
    """A monitor of a plant by its digest. Raises NotFound."""
    return _require(tx.monitors.get(plant, digest), "monitor", digest)


def alarm(tx: ReadTransaction, plant: str, name: str) -> AlarmRecord:
    """An alarm of a plant by its id. Raises NotFound."""
    record = tx.alarms.get(name)
    return _require(record if record is not None and record.plant == plant else None, "alarm", name)


def channel(tx: ReadTransaction, plant: str, name: str) -> ChannelRecord:
    """A channel of a plant by its name. Raises NotFound."""
    return _require(tx.channels.get(plant, name), "channel", name)


def channel_move(tx: ReadTransaction, plant: str, name: str) -> ChannelMove:
    """Where a channel stands. Raises NotFound."""
    channel(tx, plant, name)
    move = tx.channel_moves.last(plant, name)
    if move is None:
        raise NotFound(
            f"channel {name!r} serves nothing yet",
            noun="position",
            name=name,
            hint="Move it to an artifact that serves.",
        )
    return move


def any_decision(tx: ReadTransaction, digest: str) -> DecisionRecord:
    """A decision of any plant by its digest. Raises NotFound."""
    return _require(tx.decisions.get(digest), "decision", digest)


def decision(tx: ReadTransaction, plant: str, digest: str) -> DecisionRecord:
    """A decision of a plant by its digest. Raises NotFound."""
    record = any_decision(tx, digest)
    return _require(record if record.plant == plant else None, "decision", digest)


def serving(tx: ReadTransaction, plant: str) -> Move:
    """Where a plant's serving pointer stands. Raises NotFound."""
    return _require(tx.serving.now(plant), "plant", plant)


def _require(record: T | None, noun: str, name: str) -> T:
    if record is None:
        raise not_found(noun, name)
    return record


def not_found(noun: str, name: str) -> NotFound:
    """The error for what does not exist, and for what a token does not see."""
    return NotFound(f"there is no {noun} {name!r} here", noun=noun, name=name)
