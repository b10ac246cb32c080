"""Calls on who may do what: projects and tokens."""

from __future__ import annotations

import json
from collections.abc import Iterator

from trueup_client.records import Identity, IssuedToken, Project, Token
from trueup_client.transport import Transport, url_path


class AccessCalls(Transport):
    """Projects and tokens."""

    def whoami(self) -> Identity:
        """Returns who this client is to the service: name, roles, project, plant."""
        return self._get(url_path("session"))

    def create_project(self, name: str) -> Project:
        """Creates a project."""
        return self._post(url_path("projects"), {"name": name})

    def projects(self) -> Iterator[Project]:
        """Yields the projects."""
        return self._pages(url_path("projects"), "after")

    def issue_token(
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
        body = {"name": name, "roles": roles, "project": project, "plant": plant, "days": days}
        headers = {"Content-Type": "application/json"}
        return json.loads(
            self._connection.once("POST", url_path("tokens"), json.dumps(body).encode(), headers)
        )

    def tokens(self) -> Iterator[Token]:
        """Yields the tokens, without their secrets."""
        return self._pages(url_path("tokens"), "after")

    def revoke_token(self, prefix: str) -> Token:
        """Revokes a token for good."""
        return self._post(url_path("tokens", prefix, "revoke"), None)
