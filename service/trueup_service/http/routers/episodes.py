"""Routes of episodes: upload recordings of any format, list, get, download."""

from __future__ import annotations

from typing import Annotated

from fastapi import Query, Request, Response
from starlette.concurrency import run_in_threadpool
from starlette.responses import StreamingResponse

from trueup.episode.role import Role
from trueup.recording.described import ARCHIVE_TYPES, MEDIA_TYPES
from trueup_service.actions import find
from trueup_service.actions.ingestion import plant_context
from trueup_service.actions.move_pointer import position_document
from trueup_service.errors import CannotBeDeleted
from trueup_service.http.dependencies import (
    Digest,
    IdempotencyKey,
    Limit,
    PlantName,
    RequestContext,
    RequestParts,
)
from trueup_service.http.downloads import send_blob
from trueup_service.http.guard import guarded
from trueup_service.http.openapi import already_exists
from trueup_service.http.schemas.episodes import Episode, EpisodeContext
from trueup_service.http.schemas.serving import Serving
from trueup_service.http.schemas.wire import Page, page
from trueup_service.http.uploads import (
    RecordingDescription,
    ingest_response,
    inspected_episode,
    received,
)
from trueup_service.inspection import Inspected
from trueup_service.registry.transaction import reading
from trueup_service.wiring import Parts

router = guarded("/v1/plants/{plant}/episodes", ["episodes"])
BINARY = {"schema": {"type": "string", "format": "binary"}}
RECORDING = {
    "requestBody": {
        "required": True,
        "content": dict.fromkeys(
            [
                "application/octet-stream",
                *ARCHIVE_TYPES,
                *(media_type for of in MEDIA_TYPES.values() for media_type in of),
            ],
            BINARY,
        ),
    }
}


@router.post(
    "",
    status_code=201,
    response_model=Episode,
    summary="Upload an episode",
    responses=already_exists(Episode),
    openapi_extra=RECORDING,
)
async def upload(
    request: Request,
    parts: RequestParts,
    context: RequestContext,
    plant: PlantName,
    described: RecordingDescription,
    key: IdempotencyKey = None,
) -> Response:
    """The body is a recording: an MCAP file with its role and JointState on the plant's topics, or
    a file of another format that docs/recordings.md lists, with its role as a parameter. That
    becomes an episode that is kept as MCAP, whose `source` names the file by its SHA-256. The body
    is hashed while it streams, and compared with `Content-Digest` (RFC 9530) if that is sent.

    All or nothing: once answered, the bytes and their audit entry are durable. The same bytes again
    are the same episode. Where names do not tell which signals are meant, the answer is 422 with
    the `mapping` that is guessed, to be sent back.
    """
    against = await run_in_threadpool(plant_context, parts, plant)
    async with received(request, parts.spool, parts.settings.upload_limit_bytes) as file:
        known = await run_in_threadpool(_known, parts, plant, file.digest)
        if known is not None:
            return await run_in_threadpool(ingest_response, parts, context, plant, key, file, known)
        async with inspected_episode(request, file, against, described) as (episode, inspected):
            return await run_in_threadpool(
                ingest_response,
                parts,
                context,
                plant,
                key,
                episode,
                inspected,
                described.name,
            )


def _known(parts: Parts, plant: str, digest: str) -> Inspected | None:
    with reading(parts.database) as tx:
        record = tx.episodes.get(plant, digest)
    return (
        None
        if record is None
        else Inspected(
            digest,
            record.role,
            record.start_ns,
            record.end_ns,
            record.summary,
            record.samples_digest,
        )
    )


@router.get("", summary="List episodes")
def list_episodes(
    parts: RequestParts,
    plant: PlantName,
    role: Role | None = None,
    after: Annotated[str, Query(max_length=64)] = "",
    limit: Limit = 100,
) -> Page[Episode]:
    """In the order of their digests; `after` is the last digest of the page before."""
    with reading(parts.database) as tx:
        find.plant_digest(tx, plant)
        episodes = tx.episodes.page(plant, role, after, limit)
    return page(Episode, episodes, limit, "digest")


@router.get("/{digest}", summary="Get an episode with what was serving while it was recorded")
def get_episode(parts: RequestParts, plant: PlantName, digest: Digest) -> EpisodeContext:
    with reading(parts.database) as tx:
        episode = find.episode(tx, plant, digest)
        uses, served = find.uses(tx, digest), find.served_during(tx, episode)
    return EpisodeContext(
        **Episode.model_validate(episode).model_dump(),
        served=[Serving(**position_document(m)) for m in served],
        uses=uses,
    )


@router.get("/{digest}/content", summary="Download an episode's bytes", response_class=Response)
def download(parts: RequestParts, plant: PlantName, digest: Digest) -> StreamingResponse:
    with reading(parts.database) as tx:
        episode = find.episode(tx, plant, digest)
    return send_blob(parts.blobs, digest, episode.size_bytes)


@router.delete("/{digest}", summary="Refused: episodes are kept", status_code=204)
def delete(parts: RequestParts, plant: PlantName, digest: Digest) -> None:
    with reading(parts.database) as tx:
        find.episode(tx, plant, digest)
        raise CannotBeDeleted(
            f"episode {digest[:12]} is kept: fits and decisions name it",
            uses=sum(find.uses(tx, digest).values()),
        )
