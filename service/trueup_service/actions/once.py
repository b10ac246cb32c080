"""Do a request once, however often it is sent under one idempotency key."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from trueup.canonical import Json
from trueup_service.errors import KeyReused
from trueup_service.registry.store import Writer


@dataclass(frozen=True, slots=True)
class Key:
    """An idempotency key, what it is used for, and the digest of the request."""

    scope: str
    value: str
    request: str


def once(writer: Writer, key: Key, now: str, act: Callable[[], dict[str, Json]]) -> dict[str, Json]:
    """The response of `act`, or the one given before under this key. Raises KeyReused if that was
    to another request."""
    writer.lock_name(f"key {key.scope} {key.value}")
    known = writer.remembered(key.scope, key.value)
    if known is None:
        response = act()
        writer.remember(key.scope, key.value, key.request, response, now)
        return response
    if known[0] != key.request:
        raise KeyReused(key=key.value)
    return known[1]
