"""Routes of artifacts, the versions of a plant's model, and of the arrays that they name."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

from fastapi import Query, Request, Response
from fastapi.concurrency import contextmanager_in_threadpool
from starlette.concurrency import run_in_threadpool
from starlette.responses import StreamingResponse

from trueup.canonical import Json, digest_of_bytes, is_digest
from trueup.errors import BadArtifact, BrokenChain
from trueup.ledger.provenance import PAYLOAD_TYPE, of_artifact
from trueup_service.actions import find
from trueup_service.actions.idempotency import created_once
from trueup_service.actions.ingestion import ReceivedFile
from trueup_service.actor_context import ActorContext
from trueup_service.errors import CannotBeDeleted, DigestMismatch, NotFound
from trueup_service.http.dependencies import (
    Digest,
    IdempotencyKey,
    Limit,
    PlantName,
    RequestContext,
    RequestParts,
    created,
    inspector_of,
)
from trueup_service.http.direct import direct
from trueup_service.http.downloads import UNCHANGING, send_blob
from trueup_service.http.guard import guarded
from trueup_service.http.openapi import already_exists
from trueup_service.http.schemas.serving import Artifact
from trueup_service.http.schemas.wire import Envelope, Page, page
from trueup_service.http.uploads import ARRAYS_HINT, allow, received
from trueup_service.registry.blobs import Blobs
from trueup_service.registry.transaction import reading
from trueup_service.wiring import Parts

if TYPE_CHECKING:
    from trueup.artifact.artifact import Artifact as Bytes

router = guarded("/v1", ["artifacts"])
SMALL_BYTES = 1 << 16  # of a manifest that is read at once
MANIFEST = {
    "requestBody": {
        "required": True,
        "content": {"application/json": {"schema": {"type": "object"}}},
    }
}
ARRAYS = {
    "requestBody": {
        "required": True,
        "content": {"application/octet-stream": {"schema": {"type": "string", "format": "binary"}}},
    }
}


@router.put(
    "/blobs/{digest}",
    status_code=201,
    summary="Upload arrays under their digest",
    openapi_extra=ARRAYS,
)
async def put_blob(request: Request, parts: RequestParts, digest: Digest) -> dict[str, str | int]:
    """The bytes are durable once answered. The digest in the path is verified while they stream."""
    limit = min(parts.settings.upload_limit_bytes, parts.settings.arrays_limit_bytes)
    async with received(request, parts.spool, limit, ARRAYS_HINT) as file:
        await run_in_threadpool(_keep, parts.blobs, digest, file)
        return {"digest": digest, "size_bytes": file.size_bytes}


def _keep(blobs: Blobs, digest: str, file: ReceivedFile) -> None:
    if file.digest != digest:
        raise DigestMismatch(
            "the body is not what the path names", expected=digest, found=file.digest
        )
    blobs.put(digest, file.path)


@router.get(
    "/blobs/{digest}",
    summary="Download bytes by their digest, for auditors",
    response_class=Response,
)
def get_blob(parts: RequestParts, digest: Digest) -> StreamingResponse:
    return _blob(parts.blobs, digest)


def _blob(blobs: Blobs, digest: str) -> StreamingResponse:
    if not blobs.holds(digest):
        raise NotFound(f"there is no blob {digest!r} here", noun="blob", name=digest)
    return send_blob(blobs, digest)


@direct(
    router,
    "POST",
    "/plants/{plant}/artifacts",
    status_code=201,
    response_model=Artifact,
    summary="Add an artifact as the next version",
    responses=already_exists(Artifact),
    openapi_extra=MANIFEST,
)
async def add(
    request: Request,
    parts: RequestParts,
    context: RequestContext,
    plant: PlantName,
    key: IdempotencyKey = None,
) -> Response:
    """The body is the exact bytes of the manifest. Arrays that it names must have been uploaded
    before. The predictor must load and answer its probe."""
    manifest = await request.body()
    if len(manifest) > SMALL_BYTES:
        artifact = await run_in_threadpool(_read, manifest)
    else:
        artifact = _read(manifest)
    named = artifact.document.get("arrays")
    digest = named.get("sha256") if isinstance(named, dict) else None
    if digest is None:
        await inspector_of(request).try_artifact(manifest, None)
        return await _add(parts, context, plant, artifact, key)
    arrays = await run_in_threadpool(_uploaded, parts, digest)
    async with contextmanager_in_threadpool(parts.blobs.local_copy(arrays, parts.spool)) as path:
        await inspector_of(request).try_artifact(manifest, path)
        answer = await _add(parts, context, plant, artifact, key)
        # Bytes that were put long ago may have been collected before this row named them.
        await run_in_threadpool(parts.blobs.put, arrays, path)
        return answer


def _read(manifest: bytes) -> Bytes:
    """An artifact without its arrays. Raises BadArtifact."""
    from trueup.artifact.artifact import Artifact as Bytes  # noqa: PLC0415  (numpy: a server that only serves needs none)

    return Bytes.of(manifest, lambda _: b"")


def _uploaded(parts: Parts, digest: Json) -> str:
    """The digest of arrays, which must have been uploaded before. Raises BadArtifact,
    TooLargeUpload."""
    if not isinstance(digest, str) or not is_digest(digest) or not parts.blobs.holds(digest):
        raise BadArtifact(
            "the arrays that the manifest names are not here",
            arrays=digest,
            hint="PUT them to /v1/blobs/{digest} first.",
        )
    allow(parts.blobs.size(digest), parts.settings.arrays_limit_bytes, ARRAYS_HINT)
    return digest


async def _add(
    parts: Parts, context: ActorContext, plant: str, artifact: Bytes, key: str | None
) -> Response:
    from trueup_service.actions.add_artifact import add_artifact  # noqa: PLC0415

    added = created_once(
        context,
        f"artifacts/{plant}",
        key,
        {"digest": artifact.digest},
        lambda tx: add_artifact(tx, plant, artifact, None, context),
    )
    return created(await parts.writer.run_async(added), Artifact)


@router.get("/plants/{plant}/artifacts", summary="List versions")
def list_artifacts(
    parts: RequestParts,
    plant: PlantName,
    after: Annotated[int, Query(ge=0, le=2**31 - 1, description="version")] = 0,
    limit: Limit = 100,
) -> Page[Artifact]:
    with reading(parts.database) as tx:
        find.plant_digest(tx, plant)
        artifacts = tx.artifacts.page(plant, after, limit)
    return page(Artifact, artifacts, limit, "version")


@router.get("/plants/{plant}/artifacts/{digest}", summary="Get an artifact's registration")
def get_artifact(parts: RequestParts, plant: PlantName, digest: Digest) -> Artifact:
    with reading(parts.database) as tx:
        return Artifact.model_validate(find.artifact(tx, plant, digest))


@router.get(
    "/plants/{plant}/versions/{version}", summary="Get an artifact's registration by version"
)
def get_version(parts: RequestParts, plant: PlantName, version: int) -> Artifact:
    with reading(parts.database) as tx:
        record = tx.artifacts.by_version(plant, version) if 0 < version < 2**31 else None
    if record is None:
        raise NotFound(
            f"plant {plant!r} has no version {version}", noun="version", name=str(version)
        )
    return Artifact.model_validate(record)


@router.get(
    "/plants/{plant}/artifacts/{digest}/manifest",
    summary="Download the manifest's exact bytes",
    response_class=Response,
)
def get_manifest(parts: RequestParts, plant: PlantName, digest: Digest) -> Response:
    """The SHA-256 of the bytes is the artifact's name."""
    with reading(parts.database) as tx:
        record = find.artifact(tx, plant, digest)
    if digest_of_bytes(record.manifest.encode()) != digest:
        raise BrokenChain("the kept manifest is not the one that its digest names", artifact=digest)
    headers = {"ETag": f'"{digest}"', "Cache-Control": UNCHANGING}
    return Response(record.manifest, media_type="application/json", headers=headers)


@router.get(
    "/plants/{plant}/artifacts/{digest}/arrays",
    summary="Download an artifact's arrays",
    response_class=Response,
)
def get_arrays(parts: RequestParts, plant: PlantName, digest: Digest) -> StreamingResponse:
    """The bytes that the manifest names."""
    with reading(parts.database) as tx:
        arrays = find.artifact(tx, plant, digest).arrays
    if arrays is None:
        raise NotFound(f"artifact {digest[:12]} has no arrays", noun="arrays", name=digest)
    return _blob(parts.blobs, arrays)


@router.get(
    "/plants/{plant}/artifacts/{digest}/provenance", summary="Where an artifact comes from, signed"
)
def get_provenance(
    request: Request, parts: RequestParts, plant: PlantName, digest: Digest
) -> Envelope:
    """An in-toto statement (SLSA provenance) in a DSSE envelope: episodes, plant, parent,
    configuration and code by digest."""
    from trueup.artifact.artifact import Artifact as Bytes  # noqa: PLC0415  (numpy: a server that only serves needs none)

    with reading(parts.database) as tx:
        record = find.artifact(tx, plant, digest)
    artifact = Bytes(record.manifest.encode(), b"")
    if artifact.digest != digest:
        raise BrokenChain("the kept manifest is not the one that its digest names", artifact=digest)
    facts: dict[str, Json] = {
        name: getattr(record, name)
        for name in ("plant", "version", "job", "created_at", "created_by")
    }
    return Envelope(
        **request.app.state.log.envelope(
            PAYLOAD_TYPE, of_artifact(artifact.document, digest, facts)
        )
    )


@router.delete(
    "/plants/{plant}/artifacts/{digest}", summary="Refused: artifacts are kept", status_code=204
)
def delete(parts: RequestParts, plant: PlantName, digest: Digest) -> None:
    with reading(parts.database) as tx:
        find.artifact(tx, plant, digest)
        serves = find.serving(tx, plant).artifact == digest
        raise CannotBeDeleted(
            f"artifact {digest[:12]} is kept",
            serves=serves,
            decisions=tx.decisions.naming(plant, digest),
        )
