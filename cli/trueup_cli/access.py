"""Commands on tokens and projects, for admins, and signing in."""

from __future__ import annotations

import os
import sys
from typing import Annotated

from cyclopts import App, Parameter

from trueup_cli.exits import ASKS, told
from trueup_cli.options import DEFAULT_URL, Json, Url, connect, login_file
from trueup_cli.show import as_json, err, moment, say, table
from trueup_client import Client
from trueup_client.records import Token

tokens = App(name="token", help="Issue, list and revoke tokens.", help_epilogue=told(ASKS))
projects = App(name="project", help="Create and list projects.", help_epilogue=told(ASKS))


@tokens.command
def issue(
    name: str,
    *roles: str,
    project: Annotated[str | None, Parameter(help="Of this project alone; default: of all")] = None,
    plant: Annotated[str | None, Parameter(help="Of this plant alone; a robot's must be")] = None,
    days: Annotated[float, Parameter(help="Until it expires; 0 for never")] = 365.0,
    url: Url = DEFAULT_URL,
    as_json_: Json = False,
) -> None:
    """Issue a token and print it, this once.

    Parameters
    ----------
    name
        who it is for; stands in the log behind everything that is done with it
    roles
        robot, engineer, operator, auditor or admin; several but for a robot
    """
    made = connect(url).issue_token(name, list(roles), project, plant, days or None)
    if as_json_:
        as_json(made)
        return
    say("{}", made["token"])
    until = f"until {moment(made['expires_at'])}" if made["expires_at"] else "without an end"
    say(
        "[dim]{}: {}, {}; kept nowhere: give it to its owner now[/]",
        name,
        ", ".join(made["roles"]),
        until,
        to=err,
    )


@tokens.command(name="list")
def list_tokens(*, url: Url = DEFAULT_URL, as_json_: Json = False) -> None:
    """List tokens, without their secrets."""
    found = list(connect(url).tokens())
    if as_json_:
        as_json(found)
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
        for t in found
    ]
    table("", ["prefix", "name", "roles", "project", "plant", "expires", "state"], rows)


def _state(token: Token) -> str:
    return f"revoked by {token['revoked_by']}" if token["revoked_at"] else ""


@tokens.command
def revoke(prefix: str, *, url: Url = DEFAULT_URL, as_json_: Json = False) -> None:
    """Revoke a token, for good.

    Parameters
    ----------
    prefix
        its public part, the twelve digits behind trueup_
    """
    gone = connect(url).revoke_token(prefix)
    as_json(gone) if as_json_ else say("{} is revoked", gone["name"])


@projects.command
def create(name: str, *, url: Url = DEFAULT_URL, as_json_: Json = False) -> None:
    """Create a project: its plants are there for its own tokens, and for those of all projects.

    Parameters
    ----------
    name
        of the project
    """
    made = connect(url).create_project(name)
    as_json(made) if as_json_ else say("project [bold]{}[/] is there", made["name"])


@projects.command(name="list")
def list_projects(*, url: Url = DEFAULT_URL, as_json_: Json = False) -> None:
    """List projects."""
    found = list(connect(url).projects())
    rows = [(p["name"], moment(p["created_at"]), p["created_by"]) for p in found]
    as_json(found) if as_json_ else table("", ["project", "since", "by"], rows)


def login(*, url: Url = DEFAULT_URL, as_json_: Json = False) -> None:
    """Keep a token for an address, read from standard input, once the service knows it."""
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
    """Say whom the service takes you for."""
    who = connect(url).whoami()
    if as_json_:
        as_json(who)
    else:
        seen = who["plant"] or who["project"] or "all projects"
        say("[bold]{}[/]: {}, {}", who["name"], ", ".join(who["roles"]), seen)
