"""Sessions, projects and tokens on the wire."""

from __future__ import annotations

from pydantic import Field

from trueup_service.control_characters import LINE
from trueup_service.http.schemas.wire import FromRecord, Name, RequestBody, Time
from trueup_service.registry.records import Role


class SignIn(RequestBody):
    """A token that is exchanged for a session."""

    token: str = Field(max_length=200)


class Identity(FromRecord):
    """Who asks, with which roles, and which project or plant the token sees, null for all."""

    name: str
    roles: list[Role]
    project: str | None
    plant: str | None


class NewProject(RequestBody):
    """A new project. Its plants are visible to its own tokens and to those of all projects."""

    name: Name


class Project(FromRecord):
    """A project."""

    name: str
    created_at: Time
    created_by: str


class NewToken(RequestBody):
    """A new token. Without `project` it sees all projects, `plant` narrows it to one plant, and
    with `days` null it does not expire."""

    name: str = Field(min_length=1, max_length=100, pattern=LINE)
    roles: list[Role] = Field(min_length=1, max_length=5)
    project: Name | None = None
    plant: Name | None = None
    days: float | None = Field(365.0, gt=0, le=36_500)


class Token(FromRecord):
    """A token, without its secret. It sees one project or plant, or all where these are null."""

    prefix: str
    name: str
    roles: list[Role]
    project: str | None
    plant: str | None
    created_at: Time
    created_by: str
    expires_at: Time | None
    revoked_at: Time | None
    revoked_by: str | None


class IssuedToken(Token):
    """A token that was issued now, with its secret."""

    token: str = Field(description="The whole token; it is shown this once")
