"""Commands on what serves."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from trueup_cli.options import DEFAULT_URL, Json, PlantName, Url, connect, witnessed
from trueup_cli.show import as_json, moment, out, progress, table
from trueup_client import Serving

Generation = Annotated[int | None, Parameter(help="Refuse if the pointer is elsewhere; default: where it is now")]


def serving(
    plant: PlantName,
    *,
    history: Annotated[bool, Parameter(negative=(), help="Every position of the pointer")] = False,
    at: str | None = None,
    url: Url = DEFAULT_URL,
    as_json_: Json = False,
) -> None:
    """Say what serves, what served when, or what was live at a time.

    Parameters
    ----------
    at
        UTC, ISO 8601, such as 2026-01-31T12:00:00Z
    """
    client = connect(url)
    if at is not None:
        live = client.served_at(plant, at)
        found = [live] if live else []
    else:
        found = list(client.history(plant)) if history else [client.serving(plant)]
    show_serving(found, as_json_=as_json_)


def promote(plant: PlantName, decision: str, *, generation: Generation = None, url: Url = DEFAULT_URL, as_json_: Json = False) -> None:
    """Serve the candidate of an accepted decision.

    Parameters
    ----------
    decision
        digest of the decision
    """
    client = witnessed(url)
    show_serving(
        [client.promote(plant, decision, client.serving(plant).generation if generation is None else generation)], as_json_=as_json_
    )


def approve(plant: PlantName, decision: str, *, url: Url = DEFAULT_URL, as_json_: Json = False) -> None:
    """Approve a decision for promotion by somebody else, where the plant's policy takes two people.

    Parameters
    ----------
    decision
        digest of the decision
    """
    found = witnessed(url).approve(plant, decision)
    if as_json_:
        as_json(found)
    else:
        out.print(f"approved by {found['actor']}; another token may promote it", markup=False)


def rollback(plant: PlantName, *, generation: Generation = None, url: Url = DEFAULT_URL, as_json_: Json = False) -> None:
    """Serve what served before, after its switchback test."""
    client = witnessed(url)
    show_serving([client.roll_back(plant, client.serving(plant).generation if generation is None else generation)], as_json_=as_json_)


def fetch(
    plant: PlantName,
    to: Path,
    *,
    artifact: Annotated[str | None, Parameter(help="Digest; default: what serves")] = None,
    url: Url = DEFAULT_URL,
    as_json_: Json = False,
) -> None:
    """Fetch an artifact into a folder, every byte verified.

    Parameters
    ----------
    to
        folder, made if it is missing
    """
    client = witnessed(url)
    digest = artifact or client.serving(plant).artifact
    with progress(f"fetch {digest[:12]}"):
        client.fetch(plant, digest, to)
    as_json({"artifact": digest, "folder": str(to)}) if as_json_ else out.print(f"{digest} is in {to}", soft_wrap=True)


def show_serving(found: list[Serving], *, as_json_: bool) -> None:
    """Print positions of a pointer."""
    if as_json_:
        as_json([asdict(s) for s in found])
    else:
        rows = [(s.generation, s.version, s.artifact[:12], moment(s.since), s.move, s.decision and s.decision[:12], s.actor) for s in found]
        table("", ["gen.", "version", "artifact", "since (UTC)", "by", "decision", "actor"], rows)
