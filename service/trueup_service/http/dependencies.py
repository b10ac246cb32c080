"""What routes depend on: the parts, the actor context and the usual parameters, and the response of
a route that makes something."""

from __future__ import annotations

from collections.abc import Callable
from datetime import UTC, datetime
from typing import Annotated, Any

from fastapi import Depends, Header, Path, Query, Request, Response
from pydantic import BaseModel

from trueup.canonical import Json
from trueup.ledger.person import actor_of
from trueup_service.actions.idempotency import Created, created_once
from trueup_service.actor_context import ActorContext, time_text
from trueup_service.authentication import Principal
from trueup_service.control_characters import control_character
from trueup_service.errors import BadRequest
from trueup_service.http.schemas.wire import NAME_PATTERN
from trueup_service.inspection import Inspector
from trueup_service.registry.transaction import Transaction
from trueup_service.wiring import Parts


async def _parts(request: Request) -> Parts:
    parts: Parts = request.app.state.parts
    return parts


async def _stamp(
    request: Request,
    actor: Annotated[
        str | None,
        Header(
            alias="Trueup-Actor",
            max_length=200,
            description="For whom; stands in the log behind the token's name",
        ),
    ] = None,
) -> ActorContext:
    principal: Principal = request.scope["principal"]
    if actor and (character := control_character(actor)):
        raise BadRequest(
            f"Trueup-Actor holds the control character {character}",
            hint="Name who asks in one line of text.",
            header="Trueup-Actor",
        )
    return ActorContext(
        actor_of(principal.name, actor), time_text(datetime.now(UTC)), principal.token
    )


RequestParts = Annotated[Parts, Depends(_parts)]
RequestContext = Annotated[ActorContext, Depends(_stamp)]
IdempotencyKey = Annotated[
    str | None,
    Header(
        alias="Idempotency-Key",
        min_length=1,
        max_length=255,
        description=(
            "The same key repeats the same request's answer; with another request it is refused"
        ),
    ),
]
PlantName = Annotated[str, Path(pattern=NAME_PATTERN, description="A plant's name")]
TokenPrefix = Annotated[str, Path(pattern=r"^[0-9a-f]{12}$", description="A token's public prefix")]
Digest = Annotated[
    str, Path(pattern=r"^[0-9a-f]{64}$", description="SHA-256, lower-case hexadecimal")
]
Limit = Annotated[int, Query(ge=1, le=1000, description="Most items in the answer")]
BeforeTime = Annotated[
    str,
    Query(
        max_length=27, description="Only what was made before this time; `next` of the page before"
    ),
]


def created(result: Created, kind: type[BaseModel]) -> Response:
    """The response to a request that makes something: 201 where the record is new, 200 where it was
    there already, with the record as `kind`."""
    body = kind.model_construct(**{name: result.record[name] for name in kind.model_fields})
    return Response(
        body.model_dump_json(),  # a record was checked when it was made
        201 if result.is_new else 200,
        media_type="application/json",
    )


def create(
    parts: Parts,
    context: ActorContext,
    scope: str,
    key: str | None,
    request: Json,
    act: Callable[[Transaction], tuple[Any, bool]],
    kind: type[BaseModel],
) -> Response:
    """Run an action that returns a record and whether it is new, once under its idempotency key,
    and respond with the record as `kind`."""
    return created(parts.writer.run(created_once(context, scope, key, request, act)), kind)


def inspector_of(request: Request) -> Inspector:
    """The inspector of what this server receives."""
    inspector: Inspector = request.app.state.inspector
    return inspector
