"""Ingestion: an inspected recording becomes an episode of its plant, and the cycle goes on where
something waits for episodes."""

from __future__ import annotations

import uuid
from dataclasses import dataclass
from pathlib import Path

import orjson

from trueup.canonical import Json
from trueup.episode.role import WATCHED
from trueup_service.actions import find
from trueup_service.actions.continue_cycle import Cycle
from trueup_service.actions.idempotency import Created, created_once
from trueup_service.actions.label import first_name
from trueup_service.actor_context import ActorContext
from trueup_service.inspection import Inspected, PlantContext
from trueup_service.registry.label_record import Labelled, LabelRecord
from trueup_service.registry.records import EpisodeRecord
from trueup_service.registry.transaction import Transaction, reading
from trueup_service.wiring import Parts


@dataclass(frozen=True, slots=True)
class ReceivedFile:
    """A received file on the spool, which is removed when the request ends, with its SHA-256 and
    its size."""

    path: Path
    digest: str
    size_bytes: int


def plant_context(parts: Parts, plant: str) -> PlantContext:
    """What a recording of a plant is inspected against. Raises NotFound."""
    with reading(parts.database) as tx:
        description = find.plant(tx, plant).document
        serving = find.artifact(tx, plant, find.serving(tx, plant).artifact)
    provenance: dict[str, Json] = orjson.loads(serving.manifest).get("provenance") or {}
    coverage = provenance.get("coverage")
    return PlantContext(description, coverage if isinstance(coverage, list) else [])


def known_episode(parts: Parts, plant: str, digest: str) -> EpisodeRecord | None:
    """An episode that was ingested before."""
    with reading(parts.database) as tx:
        return tx.episodes.get(plant, digest)


def ingest(
    parts: Parts,
    context: ActorContext,
    plant: str,
    key: str | None,
    file: ReceivedFile,
    inspected: Inspected,
    name: str | None = None,
) -> Created:
    """Make a received file, which has a name, an episode. The bytes are durable first; then one
    transaction adds the row and its entry of the log, and submits what follows from the episode.
    Raises NotFound, KeyReused."""
    parts.blobs.put(file.digest, file.path)
    is_awaited = inspected.role in WATCHED and _awaits_episodes(parts, plant)
    if is_awaited:
        parts.queue.prepare()

    def act(tx: Transaction) -> tuple[EpisodeRecord, bool]:
        record, is_new = ingest_episode(tx, plant, file, inspected, context, name)
        if is_new and is_awaited:
            Cycle(tx, parts.queue, lambda: uuid.uuid4().hex, context).go_on(plant)
        return record, is_new

    created = parts.writer.run(
        created_once(context, f"episodes/{plant}", key, {"digest": file.digest}, act)
    )
    if not parts.blobs.holds(file.digest):
        # Garbage collection took the bytes before the row that names them was there.
        parts.blobs.put(file.digest, file.path)
    return created


def ingest_episode(
    tx: Transaction,
    plant: str,
    file: ReceivedFile,
    inspected: Inspected,
    context: ActorContext,
    name: str | None = None,
) -> tuple[EpisodeRecord, bool]:
    """The episode of a file whose bytes are durable, and whether it is new: the same bytes are the
    same episode, and keep their first name. Raises NotFound."""
    digest, size_bytes = file.digest, file.size_bytes
    find.plant_digest(tx, plant)
    tx.plants.lock(plant)
    known = tx.episodes.get(plant, digest)
    if known is not None:
        return known, False
    record = EpisodeRecord(
        plant=plant,
        digest=digest,
        size_bytes=size_bytes,
        role=inspected.role,
        start_ns=inspected.start_ns,
        end_ns=inspected.end_ns,
        summary=inspected.summary,
        created_at=context.now,
        created_by=context.actor,
        samples_digest=inspected.samples_digest,
    )
    tx.episodes.add(record)
    facts: dict[str, Json] = {
        "role": record.role,
        "size_bytes": size_bytes,
        "conditions": inspected.summary["conditions"],
    }
    if "source" in inspected.summary:
        facts["source"] = inspected.summary["source"]
    if inspected.samples_digest is not None:
        facts["samples_digest"] = inspected.samples_digest
    called = first_name(name, inspected.summary["conditions"])
    if called is not None:
        facts["name"] = called
        tx.labels.put(
            LabelRecord(
                plant=plant,
                kind=Labelled.EPISODE,
                subject=digest,
                name=called,
                tags=[],
                note=None,
                updated_at=context.now,
                updated_by=context.actor,
            )
        )
    tx.log.append(context, "episode:ingested", plant=plant, subject=digest, facts=facts)
    return record, True


def _awaits_episodes(parts: Parts, plant: str) -> bool:
    """Whether a monitor, an open alarm or an update policy of the plant waits for episodes."""
    with reading(parts.database) as tx:
        return (
            tx.watches.current(plant) is not None
            or tx.alarms.open(plant) is not None
            or tx.policies.in_force(plant) is not None
        )
