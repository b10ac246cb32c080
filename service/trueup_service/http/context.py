"""What every route needs: the parts, who is asking, and the request as a unit of work."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
from datetime import UTC, datetime
from typing import Annotated, Any

from fastapi import Depends, Header, Path, Query, Request, Response
from pydantic import BaseModel

from trueup.canonical import Json, digest_of
from trueup.ledger.person import actor_of
from trueup_service.actions.once import Key, once
from trueup_service.actor_context import ActorContext, time_text
from trueup_service.errors import BadRequest
from trueup_service.identity import Who
from trueup_service.plain_text import obeyed_character
from trueup_service.registry.transaction import Transaction, writing
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
    who: Who = request.scope["who"]
    if actor and (found := obeyed_character(actor)):
        raise BadRequest(
            f"Trueup-Actor holds the control character {found}",
            hint="Name who asks in one line of text.",
            header="Trueup-Actor",
        )
    return ActorContext(actor_of(who.name, actor), time_text(datetime.now(UTC)), who.token)


With = Annotated[Parts, Depends(_parts)]
By = Annotated[ActorContext, Depends(_stamp)]
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
PlantName = Annotated[
    str, Path(pattern=r"^[a-z0-9][a-z0-9_-]{0,62}$", description="A plant's name")
]
PrefixPath = Annotated[str, Path(pattern=r"^[0-9a-f]{12}$", description="A token's public prefix")]
DigestPath = Annotated[
    str, Path(pattern=r"^[0-9a-f]{64}$", description="SHA-256, lower-case hexadecimal")
]
Limit = Annotated[int, Query(ge=1, le=1000, description="Most items in the answer")]
Before = Annotated[
    str,
    Query(
        max_length=27, description="Only what was made before this time; `next` of the page before"
    ),
]


def run_once(
    parts: Parts,
    context: ActorContext,
    scope: str,
    key: str | None,
    request: Json,
    act: Callable[[Transaction], dict[str, Any]],
) -> dict[str, Any]:
    """Run an action in a transaction of its own, once under its idempotency key."""
    with writing(parts.database) as tx:
        if key is None:
            return act(tx)
        return once(
            tx,
            Key(f"{scope}@{context.token}", key, digest_of(request)),
            context.now,
            lambda: act(tx),
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
    """Run an action that makes something; 201 if it is new, 200 if it was there, with the record as
    `kind`."""

    def run(tx: Transaction) -> dict[str, Any]:
        record, new = act(tx)
        return {"record": asdict(record), "new": new}

    answer = run_once(parts, context, scope, key, request, run)
    shown = kind.model_construct(
        **{name: answer["record"][name] for name in kind.model_fields}
    )  # our own record: checked when it was made
    return Response(
        shown.model_dump_json(), 201 if answer["new"] else 200, media_type="application/json"
    )
