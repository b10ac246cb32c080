"""Responses kept under idempotency keys. The log does not name them."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Sequence

from sqlalchemy import bindparam, delete, func, select

from trueup.canonical import Json
from trueup_service.registry import tables as t
from trueup_service.registry.repository import TableGateway

KeptResponse = tuple[str, str, str]  # the scope, the key, and the time of the response
_FORGET = delete(t.idempotency).where(
    t.idempotency.c.scope == bindparam("of"),
    t.idempotency.c.key == bindparam("under"),
    t.idempotency.c.at == bindparam("since"),
)


class Idempotency:
    """Responses by scope and key."""

    def __init__(self, gateway: TableGateway) -> None:
        self._gateway = gateway
        self._connection = gateway.connection

    def response(self, scope: str, key: str) -> tuple[str, dict[str, Json]] | None:
        """The digest of the request that a key was used for, and the response to it."""
        row = self._connection.execute(
            select(t.idempotency.c.request_digest, t.idempotency.c.response).where(
                t.idempotency.c.scope == scope, t.idempotency.c.key == key
            )
        ).first()
        return (row.request_digest, json.loads(row.response)) if row else None

    def keep(
        self, scope: str, key: str, request_digest: str, response: dict[str, Json], now: str
    ) -> None:
        """Keep the response to a request under its idempotency key."""
        self._gateway.add(
            t.idempotency,
            {
                "scope": scope,
                "key": key,
                "request_digest": request_digest,
                "response": json.dumps(response),
                "at": now,
            },
        )

    def expired(self, before: str, kept_of_each_token: int) -> list[KeptResponse]:
        """The responses given before a time, and of each token all but the newest ones."""
        of, counts = t.idempotency.c, Counter[str]()
        responses = select(of.scope, of.key, of.at).order_by(of.at.desc(), of.scope, of.key)
        total = self._connection.scalar(select(func.count()).select_from(t.idempotency)) or 0
        if total <= kept_of_each_token:
            responses = responses.where(of.at < before)  # no token can have more
        expired = []
        for scope, key, at in self._connection.execute(responses):
            token = scope.rpartition("@")[2]
            counts[token] += 1
            if at < before or counts[token] > kept_of_each_token:
                expired.append((scope, key, at))
        return expired

    def forget(self, responses: Sequence[KeptResponse]) -> None:
        """Delete responses."""
        self._connection.execute(
            _FORGET, [{"of": scope, "under": key, "since": at} for scope, key, at in responses]
        )
