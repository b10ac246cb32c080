"""Do a request once, however often it is sent under one idempotency key."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from trueup.canonical import Json
from trueup_service.errors import KeyReused
from trueup_service.registry.transaction import Transaction


@dataclass(frozen=True, slots=True)
class Key:
    """An idempotency key, what it is used for, and the digest of the request."""

    scope: str
    value: str
    request: str


def once(
    tx: Transaction, key: Key, now: str, act: Callable[[], dict[str, Json]]
) -> dict[str, Json]:
    """The response of `act`, or the one given before under this key. Raises KeyReused if that was
    to another request."""
    tx.lock_name(f"key {key.scope} {key.value}")
    known = tx.idempotency.response(key.scope, key.value)
    if known is None:
        response = act()
        tx.idempotency.keep(key.scope, key.value, key.request, response, now)
        return response
    if known[0] != key.request:
        raise KeyReused(key=key.value)
    return known[1]
