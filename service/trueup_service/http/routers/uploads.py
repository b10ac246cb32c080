"""Routes of uploads in parts, for long recordings over unreliable connections: ask for the offset,
go on from there, finish."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from typing import Annotated

from fastapi import Header, Request, Response
from starlette.concurrency import run_in_threadpool
from starlette.requests import ClientDisconnect

from trueup.errors import BadEpisode, BadMapping
from trueup.recording.described import Described
from trueup_service.actions.ingestion import ReceivedFile, known_episode, plant_context
from trueup_service.actor_context import ActorContext
from trueup_service.errors import DigestMismatch, NotFound
from trueup_service.http.dependencies import (
    Digest,
    IdempotencyKey,
    PlantName,
    RequestContext,
    RequestParts,
)
from trueup_service.http.guard import guarded
from trueup_service.http.openapi import already_exists
from trueup_service.http.schemas.episodes import Episode, Upload
from trueup_service.http.uploads import (
    RecordingDescription,
    ingest_response,
    inspected_episode,
)
from trueup_service.inspection import PlantContext
from trueup_service.partial_uploads import PartialUploads, Quota, digest_of_file
from trueup_service.wiring import Parts

router = guarded("/v1/plants/{plant}/uploads/{digest}", ["episodes"])
PART = {
    "requestBody": {
        "required": True,
        "content": {"application/octet-stream": {"schema": {"type": "string", "format": "binary"}}},
    }
}
SILENCE_S = 60.0  # after which a connection that neither sends nor breaks is given up [s]
Offset = Annotated[
    int,
    Header(
        alias="Upload-Offset",
        ge=0,
        description="Where this part begins: `offset_bytes` of the last answer",
    ),
]


@router.get("", summary="How far an upload came")
def offset(parts: RequestParts, plant: PlantName, digest: Digest) -> Upload:
    """Zero where this server has no part of the upload."""
    return Upload(
        digest=digest, offset_bytes=PartialUploads(parts.settings.data_dir).offset(plant, digest)
    )


@router.patch("", summary="Send a part of an upload", openapi_extra=PART)
async def append(
    request: Request, parts: RequestParts, plant: PlantName, digest: Digest, at: Offset
) -> Upload:
    """What is answered is durable. Where the connection breaks, the received bytes are kept. 409
    tells the offset at which to go on."""
    await run_in_threadpool(plant_context, parts, plant)  # raises NotFound for an unknown plant
    uploads = PartialUploads(parts.settings.data_dir)
    quota = Quota(parts.settings.uploads_under_way, parts.settings.uploads_under_way_bytes)
    here = await uploads.append(
        plant, digest, at, _until_it_breaks(request), parts.settings.upload_limit_bytes, quota
    )
    return Upload(digest=digest, offset_bytes=here)


async def _until_it_breaks(request: Request) -> AsyncIterator[bytes]:
    """Yields the body, until the connection breaks or falls silent."""
    parts = request.stream()
    while True:
        try:
            part = await asyncio.wait_for(anext(parts), SILENCE_S)
        except (StopAsyncIteration, ClientDisconnect, TimeoutError):
            return
        yield part


@router.post(
    "/finish",
    status_code=201,
    response_model=Episode,
    summary="Make an upload an episode",
    responses=already_exists(Episode),
)
async def finish(
    request: Request,
    parts: RequestParts,
    context: RequestContext,
    plant: PlantName,
    digest: Digest,
    described: RecordingDescription,
    key: IdempotencyKey = None,
) -> Response:
    """The bytes must have the digest of the path; then it is as if they had come at once. What is
    not an episode, or has another digest, is dropped. Where the service itself fails, the upload
    stays and can be finished again."""
    uploads = PartialUploads(parts.settings.data_dir)
    against = await run_in_threadpool(plant_context, parts, plant)
    try:
        with uploads.alone(plant, digest):
            answer = await _finished(
                request, parts, context, plant, digest, key, against, described
            )
            uploads.drop(plant, digest)
            return answer
    except FileNotFoundError as error:
        known = await run_in_threadpool(known_episode, parts, plant, digest)
        if known is None:
            hint = "Send its parts first, to this server."
            raise NotFound(
                "there is no such upload here", noun="upload", name=digest, hint=hint
            ) from error
        return Response(
            Episode.model_validate(known).model_dump_json(), 200, media_type="application/json"
        )


async def _finished(
    request: Request,
    parts: Parts,
    context: ActorContext,
    plant: str,
    digest: str,
    key: str | None,
    against: PlantContext,
    described: Described,
) -> Response:
    uploads = PartialUploads(parts.settings.data_dir)
    path = uploads.path(plant, digest)
    try:
        received = await run_in_threadpool(digest_of_file, path)
        if received != digest:
            raise DigestMismatch(
                "the parts together are not what the path names", expected=digest, found=received
            )
        file = ReceivedFile(path, digest, path.stat().st_size)
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
    except DigestMismatch:
        uploads.drop(plant, digest)
        raise
    except BadEpisode as error:
        if error.code != BadMapping.code:  # it is finished again, with the mapping
            uploads.drop(plant, digest)
        raise
