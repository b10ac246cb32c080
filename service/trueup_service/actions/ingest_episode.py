"""Ingest an episode whose bytes are durable and have been inspected."""

from __future__ import annotations

from trueup.canonical import Json
from trueup_service.actions import find
from trueup_service.actions.stamp import Stamp
from trueup_service.inspection import Inspected
from trueup_service.registry.records import EpisodeRecord
from trueup_service.registry.store import Writer


def ingest_episode(
    writer: Writer, plant: str, digest: str, size_bytes: int, inspected: Inspected, stamp: Stamp
) -> tuple[EpisodeRecord, bool]:
    """The episode, and whether it is new: the same bytes are the same episode."""
    find.plant_digest(writer, plant)
    writer.lock_plant(plant)
    known = writer.episode(plant, digest)
    if known is not None:
        return known, False
    record = EpisodeRecord(
        plant,
        digest,
        size_bytes,
        inspected.role,
        inspected.start_ns,
        inspected.end_ns,
        inspected.summary,
        stamp.now,
        stamp.actor,
        inspected.samples_digest,
    )
    writer.add_episode(record)
    facts: dict[str, Json] = {
        "role": record.role,
        "size_bytes": size_bytes,
        "conditions": inspected.summary["conditions"],
    }
    if inspected.samples_digest is not None:
        facts["samples_digest"] = inspected.samples_digest
    writer.append_audit(
        at=stamp.now,
        kind="episode:ingested",
        actor=stamp.actor,
        plant=plant,
        subject=digest,
        facts=facts,
    )
    return record, True
