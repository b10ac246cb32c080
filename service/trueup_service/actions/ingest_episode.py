"""Ingest an episode whose bytes are durable and have been inspected."""

from __future__ import annotations

from trueup.canonical import Json
from trueup_service.actions import find
from trueup_service.actor_context import ActorContext
from trueup_service.inspection import Inspected
from trueup_service.registry.records import EpisodeRecord
from trueup_service.registry.transaction import Transaction


def ingest_episode(
    tx: Transaction,
    plant: str,
    digest: str,
    size_bytes: int,
    inspected: Inspected,
    context: ActorContext,
) -> tuple[EpisodeRecord, bool]:
    """The episode, and whether it is new: the same bytes are the same episode."""
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
    if inspected.samples_digest is not None:
        facts["samples_digest"] = inspected.samples_digest
    tx.log.append(context, "episode:ingested", plant=plant, subject=digest, facts=facts)
    return record, True
