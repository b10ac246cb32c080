"""Routes of serving: which version serves a plant, its history, promotion and rollback."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from typing import Annotated

from fastapi import Query, Request, Response
from starlette.concurrency import run_in_threadpool

from trueup.canonical import Json
from trueup_service.actions import find, promotion
from trueup_service.actions.move_pointer import position_document
from trueup_service.actor_context import time_text
from trueup_service.errors import InTheFuture
from trueup_service.http.dependencies import (
    IdempotencyKey,
    Limit,
    PlantName,
    RequestContext,
    RequestParts,
)
from trueup_service.http.direct import direct
from trueup_service.http.guard import guarded
from trueup_service.http.polling import ASKED, PLANT, UNCHANGED, polled
from trueup_service.http.schemas.serving import Promotion, Rollback, Serving
from trueup_service.http.schemas.wire import Envelope, Page
from trueup_service.registry.transaction import reading
from trueup_service.signed_log import SignedLog

router = guarded("/v1/plants/{plant}/serving", ["serving"])
ENVELOPE_TYPE, ENVELOPE_SCHEMA = "application/vnd.trueup.serving+json", "trueup.serving/1"
AtTime = Annotated[
    str | None,
    Query(
        pattern=r"^\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d(\.\d{1,6})?Z$",
        description="UTC, ISO 8601: only what was live then",
    ),
]


@direct(
    router,
    "GET",
    "",
    summary="What is serving now",
    response_model=Serving,
    responses=UNCHANGED,
    openapi_extra={"parameters": [PLANT, *ASKED]},
)
async def now(request: Request) -> Response:
    """Never older than the last acknowledged move. With `If-None-Match` and `wait_s` the response
    comes at the next move, or is 304."""
    return await polled(request, request.path_params["plant"])


@router.get("/envelope", summary="What is serving now, signed for a robot")
def envelope(request: Request, parts: RequestParts, plant: PlantName) -> Envelope:
    """A DSSE envelope with artifact, generation (which only grows), decision, expiry, the artifact
    that served before as the fallback, and the log's checkpoint, which makes every robot a witness
    of the log."""
    with reading(parts.database) as tx:
        move = find.serving(tx, plant)
        back = None if move.back_to is None else tx.serving.at_generation(plant, move.back_to)
    log: SignedLog = request.app.state.log
    issued = datetime.now(UTC)
    statement: dict[str, Json] = {
        "schema": ENVELOPE_SCHEMA,
        "plant": plant,
        "artifact": move.artifact,
        "version": move.version,
        "generation": move.generation,
        "decision": move.decision,
        "fallback": None if back is None else back.artifact,
        "issued_at": time_text(issued),
        "expires_at": time_text(issued + timedelta(seconds=parts.settings.serving_lease_s)),
        "checkpoint": log.checkpoint(),
    }
    return Envelope(**log.envelope(ENVELOPE_TYPE, statement))


@router.get("/history", summary="What served when")
def history(
    parts: RequestParts,
    plant: PlantName,
    at: AtTime = None,
    after: Annotated[int, Query(ge=0, le=2**31 - 1, description="generation")] = 0,
    limit: Limit = 100,
) -> Page[Serving]:
    """Every position of the pointer in order, or with `at`, a time that has passed, the one at that
    time."""
    with reading(parts.database) as tx:
        find.plant_digest(tx, plant)
        if at is not None:
            _require_past(_padded(at))
            live = tx.serving.at_time(plant, _padded(at))
            return Page(items=[Serving(**position_document(live))] if live else [])
        moves = tx.serving.history(plant, after, limit)
    return Page(
        items=[Serving(**position_document(m)) for m in moves],
        next=str(moves[-1].generation) if len(moves) == limit else None,
    )


def _require_past(at: str) -> None:
    """Raises InTheFuture for a time that has not come: nobody knows what will serve then."""
    now = time_text(datetime.now(UTC))
    if at > now:
        raise InTheFuture(
            f"{at} is in the future; it is {now} here, and what serves then is not known",
            at=at,
            now=now,
        )


def _padded(at: str) -> str:
    whole, _, fraction = at.removesuffix("Z").partition(".")
    return f"{whole}.{fraction:<06}Z"


@direct(router, "POST", "/promote", summary="Serve an accepted candidate", response_model=Serving)
async def promote(
    request: Request,
    parts: RequestParts,
    context: RequestContext,
    plant: PlantName,
    wanted: Promotion,
    key: IdempotencyKey = None,
) -> Response:
    """Compare and swap: 409 if the pointer is at another generation, the decision was judged at
    another one, or approvals are missing."""
    moved = await promotion.promote(
        parts, context, plant, wanted.decision, wanted.expected_generation, key
    )
    request.app.state.answers.wake()
    return Response(Serving(**moved).model_dump_json(), media_type="application/json")


@router.post("/rollback", summary="Serve what served before")
async def rollback(
    request: Request,
    parts: RequestParts,
    context: RequestContext,
    plant: PlantName,
    wanted: Rollback,
    key: IdempotencyKey = None,
) -> Serving:
    """The pointer moves after the switchback test: the artifact loads, its digests hold, it answers
    its recorded probe, and it fits the plant. Where it does not, the refusal names the next older
    artifact that does (`next`), which `to_generation` reaches.

    The audit entry of the move holds what the switch is compatible with: code and libraries, the
    session state of a running controller, and the fallback."""
    moved = await run_in_threadpool(
        promotion.roll_back,
        parts,
        context,
        plant,
        wanted.expected_generation,
        key,
        wanted.to_generation,
    )
    request.app.state.answers.wake()
    return Serving(**moved)
