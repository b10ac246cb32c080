"""Ingest what was received: inspected in a process of its own, durable before the row, and shown to
the plant's monitor."""

from __future__ import annotations

import uuid
from pathlib import Path

import orjson
from fastapi import Request, Response

from trueup.canonical import Json
from trueup.episode.role import WATCHED
from trueup_service.actions import find
from trueup_service.actions.continue_cycle import Cycle
from trueup_service.actions.ingest_episode import ingest_episode
from trueup_service.actor_context import ActorContext
from trueup_service.http.context import create
from trueup_service.http.schemas import Episode
from trueup_service.http.uploads import Received
from trueup_service.inspection import Against, Inspected, Inspector
from trueup_service.registry.records import EpisodeRecord
from trueup_service.registry.transaction import Transaction, reading
from trueup_service.wiring import Parts


def against(parts: Parts, plant: str) -> Against:
    """What an upload to a plant is held against. Raises NotFound."""
    with reading(parts.database) as tx:
        document = find.plant(tx, plant).document
        serving = find.artifact(tx, plant, find.serving(tx, plant).artifact)
    provenance: dict[str, Json] = orjson.loads(serving.manifest).get("provenance") or {}
    coverage = provenance.get("coverage")
    return Against(document, coverage if isinstance(coverage, list) else [])


async def inspect(
    request: Request, path: Path, held: Against, *, telemetry: bool = False
) -> Inspected:
    """What a file holds, once there is a slot to look at it. Raises BadEpisode,
    InspectionFailed."""
    return await inspector_of(request).inspect(path, held, telemetry=telemetry)


def inspector_of(request: Request) -> Inspector:
    """Who inspects what this server receives."""
    inspector: Inspector = request.app.state.inspector
    return inspector


def ingest(
    parts: Parts,
    context: ActorContext,
    plant: str,
    key: str | None,
    file: Received,
    inspected: Inspected,
) -> Response:
    """Bytes first, then the row, its audit entry and the look that the monitor takes at it, in one
    transaction."""
    parts.blobs.put(file.digest, file.path)
    watched = inspected.role in WATCHED and _is_waited_for(parts, plant)
    if watched:
        parts.queue.prepare()

    def act(tx: Transaction) -> tuple[EpisodeRecord, bool]:
        record, new = ingest_episode(tx, plant, file.digest, file.size_bytes, inspected, context)
        if new and watched:
            Cycle(tx, parts.queue, lambda: uuid.uuid4().hex, context).go_on(plant)
        return record, new

    answer = create(parts, context, f"episodes/{plant}", key, {"digest": file.digest}, act, Episode)
    if not parts.blobs.holds(file.digest):
        parts.blobs.put(
            file.digest, file.path
        )  # taken for left over in this very moment, before its row was there
    return answer


def known_episode(parts: Parts, plant: str, digest: str) -> EpisodeRecord | None:
    """An episode that is here already."""
    with reading(parts.database) as tx:
        return tx.episodes.get(plant, digest)


def _is_waited_for(parts: Parts, plant: str) -> bool:
    """Whether anybody waits for episodes: a monitor, an alarm that wants a diagnosis, a policy that
    wants a monitor."""
    with reading(parts.database) as tx:
        return any(
            of(plant) is not None
            for of in (tx.watches.current, tx.alarms.open, tx.policies.in_force)
        )
