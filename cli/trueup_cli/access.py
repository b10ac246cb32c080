"""Commands that manage tokens and projects, for admins, and that sign in."""

from __future__ import annotations

import os
import sys
from datetime import UTC, datetime
from typing import Annotated

from cyclopts import App, Parameter

from trueup_cli.exits import CALLS_SERVICE, exit_codes
from trueup_cli.options import DEFAULT_URL, Json, Url, connect, login_file
from trueup_cli.show import as_json, err, moment, say, table
from trueup_client import Client
from trueup_client.records import Token

tokens = App(
    name="token", help="Issue, list and revoke tokens.", help_epilogue=exit_codes(CALLS_SERVICE)
)
projects = App(
    name="project", help="Create and list projects.", help_epilogue=exit_codes(CALLS_SERVICE)
)


@tokens.command
def issue(
    name: str,
    *roles: str,
    project: Annotated[
        str | None, Parameter(help="Restrict it to this project; default: all projects")
    ] = None,
    plant: Annotated[
        str | None, Parameter(help="Restrict it to this plant; required for a robot")
    ] = None,
    days: Annotated[float, Parameter(help="Days until it expires; 0 for never")] = 365.0,
    url: Url = DEFAULT_URL,
    as_json_: Json = False,
) -> None:
    """Issue a token and print it. It is never shown again.

    Parameters
    ----------
    name
        whom it is for; the audit log names it with everything that the token does
    roles
        one or several of robot, engineer, operator, auditor, admin; robot stands alone
    """
    issued = connect(url).issue_token(name, list(roles), project, plant, days or None)
    if as_json_:
        as_json(issued)
        return
    say("{}", issued["token"])
    until = f"until {moment(issued['expires_at'])}" if issued["expires_at"] else "without an end"
    say(
        "[dim]{}: {}, {}; kept nowhere: give it to its owner now[/]",
        name,
        ", ".join(issued["roles"]),
        until,
        to=err,
    )


@tokens.command(name="list")
def list_tokens(
    *,
    ended: Annotated[
        bool, Parameter(help="Also those that were revoked or have expired", negative=())
    ] = False,
    url: Url = DEFAULT_URL,
    as_json_: Json = False,
) -> None:
    """List tokens, without their secrets."""
    listed = [t for t in connect(url).tokens() if ended or not _has_ended(t)]
    if as_json_:
        as_json(listed)
        return
    rows = [
        (
            t["prefix"],
            t["name"],
            ", ".join(t["roles"]),
            t["project"],
            t["plant"],
            moment(t["expires_at"] or ""),
            _state(t),
        )
        for t in listed
    ]
    table("", ["prefix", "name", "roles", "project", "plant", "expires", "state"], rows)


def _has_ended(token: Token) -> bool:
    now, expires = datetime.now(UTC), token["expires_at"]
    has_expired = expires is not None and datetime.fromisoformat(expires) <= now
    return has_expired or token["revoked_at"] is not None


def _state(token: Token) -> str:
    return f"revoked by {token['revoked_by']}" if token["revoked_at"] else ""


@tokens.command
def revoke(prefix: str, *, url: Url = DEFAULT_URL, as_json_: Json = False) -> None:
    """Revoke a token for good.

    Parameters
    ----------
    prefix
        its public part: the twelve digits after trueup_
    """
    token = connect(url).revoke_token(prefix)
    as_json(token) if as_json_ else say("{} is revoked", token["name"])


@projects.command
def create(name: str, *, url: Url = DEFAULT_URL, as_json_: Json = False) -> None:
    """Create a project. Its tokens, and those of all projects, can see its plants.

    Parameters
    ----------
    name
        name of the project
    """
    project = connect(url).create_project(name)
    as_json(project) if as_json_ else say("project [bold]{}[/] is there", project["name"])


@projects.command(name="list")
def list_projects(*, url: Url = DEFAULT_URL, as_json_: Json = False) -> None:
    """List projects."""
    listed = list(connect(url).projects())
    rows = [(p["name"], moment(p["created_at"]), p["created_by"]) for p in listed]
    as_json(listed) if as_json_ else table("", ["project", "since", "by"], rows)


def login(*, url: Url = DEFAULT_URL, as_json_: Json = False) -> None:
    """Read a token from standard input, and store it for an address once the service accepts it."""
    import getpass

    token = getpass.getpass("token: ") if sys.stdin.isatty() else sys.stdin.readline().strip()
    who = Client(url, token=token).whoami()
    path = login_file(url)
    path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    path.unlink(missing_ok=True)
    with open(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w") as file:
        file.write(token)
    if as_json_:
        as_json({**who, "kept_in": str(path)})
        return
    say(
        "{} knows you as [bold]{}[/] ({}); the token is in {}",
        url,
        who["name"],
        ", ".join(who["roles"]),
        path,
    )


def whoami(*, url: Url = DEFAULT_URL, as_json_: Json = False) -> None:
    """Show who you are to the service."""
    who = connect(url).whoami()
    if as_json_:
        as_json(who)
    else:
        scope = who["plant"] or who["project"] or "all projects"
        say("[bold]{}[/]: {}, {}", who["name"], ", ".join(who["roles"]), scope)
