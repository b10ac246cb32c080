"""Routes of evidence of artifacts, and of the channels of serving that require it."""

from __future__ import annotations

from dataclasses import asdict
from typing import Annotated, Any

from fastapi import Body, Path, Query, Request, Response

from trueup_service.actions import find
from trueup_service.actions.add_evidence import add_evidence
from trueup_service.actions.channels import declare_channel, move_channel
from trueup_service.actions.idempotency import once
from trueup_service.http.dependencies import (
    Digest,
    IdempotencyKey,
    Limit,
    PlantName,
    RequestContext,
    RequestParts,
    create,
)
from trueup_service.http.direct import direct
from trueup_service.http.guard import guarded
from trueup_service.http.openapi import already_exists
from trueup_service.http.polling import ASKED, PLANT, UNCHANGED, polled
from trueup_service.http.schemas.serving import (
    Channel,
    ChannelDeclaration,
    ChannelMove,
    ChannelPosition,
    Evidence,
)
from trueup_service.http.schemas.wire import NAME_PATTERN, Page, page
from trueup_service.registry.transaction import Transaction, reading

router = guarded("/v1/plants/{plant}", ["channels"])
ChannelName = Annotated[str, Path(pattern=NAME_PATTERN, description="A channel's name")]
PAGE_BYTES = 2 << 20  # documents of one page, unless the first one alone has more
CHANNEL = {
    "name": "channel",
    "in": "path",
    "required": True,
    "schema": {"type": "string"},
    "description": "A channel's name",
}


@router.post(
    "/evidence",
    status_code=201,
    response_model=Evidence,
    summary="Add evidence of an artifact",
    responses=already_exists(Evidence),
)
def add(
    parts: RequestParts,
    context: RequestContext,
    plant: PlantName,
    document: Annotated[
        dict[str, Any],
        Body(description="Evidence: schema, artifact, stage, passed, shows, cannot_show, figures"),
    ],
    key: IdempotencyKey = None,
) -> Response:
    """The document is stored as it is, with who sent it. What the evidence cannot show is part of
    it."""
    return create(
        parts,
        context,
        f"evidence/{plant}",
        key,
        document,
        lambda tx: add_evidence(tx, plant, document, None, context),
        Evidence,
    )


@router.get("/artifacts/{digest}/evidence", summary="List the evidence of an artifact")
def list_evidence(
    parts: RequestParts,
    plant: PlantName,
    digest: Digest,
    after: Annotated[str, Query(max_length=92)] = "",
    limit: Limit = 100,
) -> Page[Evidence]:
    """In the order of time; `after` is `next` of the page before. A page ends early where its
    documents are long."""
    at, _, last = after.partition("_")
    with reading(parts.database) as tx:
        find.artifact(tx, plant, digest)
        evidence, more = tx.evidence.page(plant, digest, (at, last), limit, PAGE_BYTES)
    return Page(
        items=[Evidence.model_validate(e) for e in evidence],
        next=f"{evidence[-1].created_at}_{evidence[-1].digest}" if more else None,
    )


@router.post(
    "/channels",
    status_code=201,
    response_model=Channel,
    summary="Declare a channel of serving",
    responses=already_exists(Channel),
)
def declare(
    parts: RequestParts,
    context: RequestContext,
    plant: PlantName,
    channel: ChannelDeclaration,
    key: IdempotencyKey = None,
) -> Response:
    """What a channel requires never changes."""
    request = channel.model_dump()

    return create(
        parts,
        context,
        f"channels/{plant}",
        key,
        request,
        lambda tx: declare_channel(tx, plant, channel.name, channel.requires, context),
        Channel,
    )


@router.get("/channels", summary="List channels")
def list_channels(
    parts: RequestParts,
    plant: PlantName,
    after: Annotated[str, Query(max_length=63)] = "",
    limit: Limit = 100,
) -> Page[Channel]:
    with reading(parts.database) as tx:
        find.plant_digest(tx, plant)
        channels = tx.channels.page(plant, after, limit)
    return page(Channel, channels, limit, "name")


@direct(
    router,
    "GET",
    "/channels/{channel}/serving",
    summary="What a channel serves now",
    response_model=ChannelPosition,
    responses=UNCHANGED,
    openapi_extra={"parameters": [PLANT, CHANNEL, *ASKED]},
)
async def serving(request: Request) -> Response:
    """As for the plant's own pointer: with `If-None-Match` and `wait_s` the response comes at the
    channel's next move, or is 304."""
    return await polled(request, request.path_params["plant"], request.path_params["channel"])


@router.post("/channels/{channel}/move", summary="Serve an artifact on a channel")
async def move(
    request: Request,
    parts: RequestParts,
    context: RequestContext,
    plant: PlantName,
    channel: ChannelName,
    wanted: ChannelMove,
    key: IdempotencyKey = None,
) -> ChannelPosition:
    """409 if the channel is at another generation, the artifact never served the plant itself, or
    evidence of a required stage is missing or failed."""

    def act(tx: Transaction) -> dict[str, Any]:
        return asdict(
            move_channel(tx, plant, channel, wanted.artifact, wanted.expected_generation, context)
        )

    scope = f"channels/{plant}/{channel}"
    moved = await parts.writer.run_async(once(context, scope, key, wanted.model_dump(), act))
    request.app.state.answers.wake()
    return ChannelPosition(**moved)
