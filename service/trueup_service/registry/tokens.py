"""Tokens, and the sessions of browsers that were begun with one."""

from __future__ import annotations

from sqlalchemy import delete, select

from trueup_service.registry import tables as t
from trueup_service.registry.records import TokenRecord
from trueup_service.registry.repository import Repository, TableGateway


class Tokens(Repository[TokenRecord]):
    """Tokens by their public prefix."""

    table, record = t.tokens, TokenRecord

    def get(self, prefix: str) -> TokenRecord | None:
        """A token by its public prefix, revoked or not."""
        return self._by(prefix=prefix)

    def page(self, after: str, limit: int) -> list[TokenRecord]:
        """Tokens by prefix from behind one."""
        return self._page(t.tokens.c.prefix, after, limit)

    def revoke(self, prefix: str, now: str, actor: str) -> bool:
        """Revoke a token. Returns False where it is revoked already."""
        return self._end_once(t.tokens.c.prefix == prefix, "revoked", now, actor)


class Sessions:
    """Sessions of browsers by the digest of their secret. The log does not name them."""

    def __init__(self, gateway: TableGateway) -> None:
        self._gateway = gateway

    def token(self, digest: str, now: str) -> str | None:
        """The prefix of the token that a session was begun with, None where the session has
        ended."""
        query = select(t.sessions.c.token).where(
            t.sessions.c.digest == digest, t.sessions.c.expires_at > now
        )
        prefix: str | None = self._gateway.connection.scalar(query)
        return prefix

    def begin(self, digest: str, token: str, now: str, expires_at: str) -> None:
        """Begin a session, and delete those that have ended."""
        self._gateway.connection.execute(delete(t.sessions).where(t.sessions.c.expires_at <= now))
        row = {"digest": digest, "token": token, "created_at": now, "expires_at": expires_at}
        self._gateway.add(t.sessions, row)

    def end(self, digest: str) -> None:
        """End a session."""
        self._gateway.connection.execute(delete(t.sessions).where(t.sessions.c.digest == digest))
