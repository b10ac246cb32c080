"""The calls of trueup_client.calls.access for an event loop.

Made by tools/make_async_client.py.
"""

from __future__ import annotations

from collections.abc import AsyncIterator

from trueup_client.calls.access import AccessCalls
from trueup_client.pool import Pooled
from trueup_client.records import Identity, IssuedToken, Project, Token


class AsyncAccessCalls(Pooled):
    """Projects and tokens. For an event loop."""

    async def whoami(self) -> Identity:
        """Returns who this client is to the service: name, roles, project, plant."""
        return await self._pool.run(AccessCalls.whoami)

    async def create_project(self, name: str) -> Project:
        """Creates a project."""
        return await self._pool.run(AccessCalls.create_project, name)

    def projects(self) -> AsyncIterator[Project]:
        """Yields the projects."""
        return self._pool.each(AccessCalls.projects)

    async def issue_token(
        self,
        name: str,
        roles: list[str],
        project: str | None = None,
        plant: str | None = None,
        days: float | None = 365.0,
    ) -> IssuedToken:
        """Issues a token. The answer's `token` is shown this once.

        The request is sent once. If its answer is lost, revoke the token and issue another.
        """
        return await self._pool.run(AccessCalls.issue_token, name, roles, project, plant, days)

    def tokens(self) -> AsyncIterator[Token]:
        """Yields the tokens, without their secrets."""
        return self._pool.each(AccessCalls.tokens)

    async def revoke_token(self, prefix: str) -> Token:
        """Revokes a token for good."""
        return await self._pool.run(AccessCalls.revoke_token, prefix)
