"""Commands on what serves."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from trueup_cli.options import DEFAULT_URL, Json, Url, connect, witnessed
from trueup_cli.show import as_json, moment, out, table
from trueup_client import Serving

Generation = Annotated[int | None, Parameter(help="Refuse if the pointer is elsewhere; default: where it is now")]


def serving(
    plant: str,
    *,
    history: Annotated[bool, Parameter(negative=(), help="Every position of the pointer")] = False,
    at: str | None = None,
    url: Url = DEFAULT_URL,
    as_json_: Json = False,
) -> None:
    """Say what serves, what served when, or what was live at a time.

    Parameters
    ----------
    plant: name of the plant
    at: UTC, ISO 8601, such as 2026-01-31T12:00:00Z
    """
    client = connect(url)
    if at is not None:
        live = client.served_at(plant, at)
        found = [live] if live else []
    else:
        found = list(client.history(plant)) if history else [client.serving(plant)]
    show_serving(found, as_json_=as_json_)


def promote(plant: str, decision: str, *, generation: Generation = None, url: Url = DEFAULT_URL, as_json_: Json = False) -> None:
    """Serve the candidate of an accepted decision.

    Parameters
    ----------
    plant: name of the plant
    decision: digest of the decision
    """
    client = witnessed(url)
    show_serving(
        [client.promote(plant, decision, client.serving(plant).generation if generation is None else generation)], as_json_=as_json_
    )


def approve(plant: str, decision: str, *, url: Url = DEFAULT_URL) -> None:
    """Approve a decision for promotion by somebody else, where the plant's policy takes two people.

    Parameters
    ----------
    plant: name of the plant
    decision: digest of the decision
    """
    found = witnessed(url).approve(plant, decision)
    out.print(f"approved by {found['actor']}; another token may promote it", markup=False)


def rollback(plant: str, *, generation: Generation = None, url: Url = DEFAULT_URL, as_json_: Json = False) -> None:
    """Serve what served before, after its switchback test."""
    client = witnessed(url)
    show_serving([client.roll_back(plant, client.serving(plant).generation if generation is None else generation)], as_json_=as_json_)


def fetch(
    plant: str, to: Path, *, artifact: Annotated[str | None, Parameter(help="Digest; default: what serves")] = None, url: Url = DEFAULT_URL
) -> None:
    """Fetch an artifact into a folder, every byte verified.

    Parameters
    ----------
    plant: name of the plant
    to: folder, made if it is missing
    """
    client = witnessed(url)
    digest = artifact or client.serving(plant).artifact
    client.fetch(plant, digest, to)
    out.print(f"{digest} is in {to}")


def show_serving(found: list[Serving], *, as_json_: bool) -> None:
    """Print positions of a pointer."""
    if as_json_:
        as_json([asdict(s) for s in found])
    else:
        rows = [(s.generation, s.version, s.artifact[:12], moment(s.since), s.move, s.decision and s.decision[:12], s.actor) for s in found]
        table("", ["gen.", "version", "artifact", "since (UTC)", "by", "decision", "actor"], rows)
