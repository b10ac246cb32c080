"""Commands on what serves."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from trueup.canonical import is_digest
from trueup.errors import NoSuchDigest
from trueup_cli.digests import whole
from trueup_cli.options import DEFAULT_URL, Json, PlantName, Url, connect, witnessed
from trueup_cli.registry import whole_artifact
from trueup_cli.show import as_json, moment, progress, say, table
from trueup_client import Client, Problem, Serving

Generation = Annotated[
    int | None, Parameter(help="Refuse if the pointer is elsewhere; default: where it is now")
]


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


def promote(
    plant: PlantName,
    decision: str,
    *,
    generation: Generation = None,
    url: Url = DEFAULT_URL,
    as_json_: Json = False,
) -> None:
    """Serve the candidate of an accepted decision.

    Parameters
    ----------
    decision
        digest of the decision, or its first digits
    """
    client = witnessed(url)
    digest, serves = _decision(client, plant, decision), client.serving(plant)
    if (
        serves.decision != digest or generation is not None
    ):  # else it was promoted before, and serves
        serves = client.promote(
            plant, digest, serves.generation if generation is None else generation
        )
    show_serving([serves], as_json_=as_json_)


def _decision(client: Client, plant: str, given: str) -> str:
    """A decision's digest by its first digits. Raises NoSuchDigest, and says so where a candidate's
    was given."""
    if is_digest(given):
        try:
            return client.decision(plant, given)["digest"]
        except Problem as problem:
            if problem.code != "not-found":
                raise
    known = list(client.decisions(plant))
    if not any(d["digest"].startswith(given) for d in known):
        judged = next((d["digest"] for d in known if d["candidate"].startswith(given)), None)
        if judged is not None:
            hint = f"Promote its newest decision: `trueup promote {plant} {judged[:12]}`."
            raise NoSuchDigest(
                f"{given[:12]} is a candidate; what is promoted is a decision on it", hint=hint
            )
        if any(a["digest"].startswith(given) for a in client.artifacts(plant)):
            hint = f"Judge it first: `trueup gate {plant} {given[:12]}`."
            raise NoSuchDigest(f"{given[:12]} is a version that no gate has judged", hint=hint)
    return whole(given, known, "decision", f"trueup decisions {plant}")


def approve(
    plant: PlantName,
    decision: str,
    *,
    because: Annotated[
        str | None, Parameter(help="Why; a candidate that was rejected before takes a reason")
    ] = None,
    url: Url = DEFAULT_URL,
    as_json_: Json = False,
) -> None:
    """Approve a decision for promotion by somebody else, where it takes two people.

    Parameters
    ----------
    decision
        digest of the decision, or its first digits
    """
    client = witnessed(url)
    found = client.approve(plant, _decision(client, plant, decision), because)
    if as_json_:
        as_json(found)
    else:
        say("approved by {}; somebody else may promote it", found["actor"])


def rollback(
    plant: PlantName,
    *,
    generation: Generation = None,
    url: Url = DEFAULT_URL,
    as_json_: Json = False,
) -> None:
    """Serve what served before, after its switchback test."""
    client = witnessed(url)
    show_serving(
        [
            client.roll_back(
                plant, client.serving(plant).generation if generation is None else generation
            )
        ],
        as_json_=as_json_,
    )


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
    digest = whole_artifact(client, plant, artifact) if artifact else client.serving(plant).artifact
    with progress(f"fetch {digest[:12]}"):
        client.fetch(plant, digest, to)
    as_json({"artifact": digest, "folder": str(to)}) if as_json_ else say("{} is in {}", digest, to)


def show_serving(found: list[Serving], *, as_json_: bool) -> None:
    """Print positions of a pointer."""
    if as_json_:
        as_json([asdict(s) for s in found])
    else:
        rows = [
            (
                s.generation,
                s.version,
                s.artifact[:12],
                moment(s.since),
                s.move,
                s.decision and s.decision[:12],
                s.actor,
            )
            for s in found
        ]
        table("", ["gen.", "version", "artifact", "since (UTC)", "by", "decision", "actor"], rows)
