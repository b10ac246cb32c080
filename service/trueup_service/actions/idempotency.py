"""Actions that are done once for each idempotency key, however often the request is sent."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

from trueup.canonical import Json, digest_of
from trueup_service.actor_context import ActorContext
from trueup_service.errors import KeyReused
from trueup_service.registry.transaction import Transaction


@dataclass(frozen=True, slots=True)
class IdempotencyKey:
    """An idempotency key, the scope in which it is unique, and the digest of the request that it
    was sent with."""

    scope: str
    value: str
    request_digest: str


@dataclass(frozen=True, slots=True)
class Created:
    """A record that an action returned, its fields by name, and whether it is new."""

    record: dict[str, Any]
    is_new: bool


def run_once_in(
    tx: Transaction, key: IdempotencyKey, now: str, act: Callable[[], dict[str, Json]]
) -> dict[str, Json]:
    """The response of `act`, or the response that was kept under this key. Raises KeyReused where
    that was the response to another request."""
    tx.lock_name(f"key {key.scope} {key.value}")
    kept = tx.idempotency.response(key.scope, key.value)
    if kept is None:
        response = act()
        tx.idempotency.keep(key.scope, key.value, key.request_digest, response, now)
        return response
    request_digest, response = kept
    if request_digest != key.request_digest:
        raise KeyReused(key=key.value)
    return response


def once(
    context: ActorContext,
    scope: str,
    key: str | None,
    request: Json,
    act: Callable[[Transaction], dict[str, Any]],
) -> Callable[[Transaction], dict[str, Any]]:
    """An action that under an idempotency key is done once: a repeated request gets the kept
    response. It raises KeyReused, and what `act` raises."""
    if key is None:
        return act
    unique = IdempotencyKey(f"{scope}@{context.token}", key, digest_of(request))
    return lambda tx: run_once_in(tx, unique, context.now, lambda: act(tx))


def created_once(
    context: ActorContext,
    scope: str,
    key: str | None,
    request: Json,
    act: Callable[[Transaction], tuple[Any, bool]],
) -> Callable[[Transaction], Created]:
    """An action as of `once`, whose `act` returns a record and whether it is new."""

    def document(tx: Transaction) -> dict[str, Any]:
        record, is_new = act(tx)
        return {"record": asdict(record), "new": is_new}

    def created(tx: Transaction) -> Created:
        response = once(context, scope, key, request, document)(tx)
        return Created(response["record"], response["new"])

    return created
