"""Commands that show and move what serves."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from trueup.canonical import is_digest
from trueup.errors import NoSuchDigest
from trueup_cli.digests import resolve_digest
from trueup_cli.options import DEFAULT_URL, Json, PlantName, Url, connect, connect_witnessed
from trueup_cli.registry import resolve_artifact
from trueup_cli.show import as_json, moment, progress, say, table
from trueup_client import Client, Problem, Serving

Generation = Annotated[
    int | None,
    Parameter(help="Refuse if the pointer is not at this generation; default: where it is"),
]


def serving(
    plant: PlantName,
    *,
    history: Annotated[bool, Parameter(negative=(), help="Every position of the pointer")] = False,
    at: str | None = None,
    url: Url = DEFAULT_URL,
    as_json_: Json = False,
) -> None:
    """Show what serves, what served when, or what served at a time.

    Parameters
    ----------
    at
        UTC, ISO 8601, such as 2026-01-31T12:00:00Z
    """
    client = connect(url)
    if at is not None:
        live = client.served_at(plant, at)
        positions = [live] if live else []
    else:
        positions = list(client.history(plant)) if history else [client.serving(plant)]
    show_serving(positions, as_json_=as_json_)


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
    client = connect_witnessed(url)
    digest, serves = _decision(client, plant, decision), client.serving(plant)
    # a decision that was promoted before and serves is not promoted again
    if serves.decision != digest or generation is not None:
        serves = client.promote(
            plant, digest, serves.generation if generation is None else generation
        )
    show_serving([serves], as_json_=as_json_)


def _decision(client: Client, plant: str, prefix: str) -> str:
    """Returns a decision's digest by its first digits.

    Raises NoSuchDigest, with a hint if the digits are those of a candidate.
    """
    if is_digest(prefix):
        try:
            return client.decision(plant, prefix)["digest"]
        except Problem as problem:
            if problem.code != "not-found":
                raise
    known = list(client.decisions(plant))
    if not any(d["digest"].startswith(prefix) for d in known):
        judged = next((d["digest"] for d in known if d["candidate"].startswith(prefix)), None)
        if judged is not None:
            hint = f"Promote its newest decision: `trueup promote {plant} {judged[:12]}`."
            raise NoSuchDigest(
                f"{prefix[:12]} is a candidate; what is promoted is a decision on it", hint=hint
            )
        if any(a["digest"].startswith(prefix) for a in client.artifacts(plant)):
            hint = f"Judge it first: `trueup gate {plant} {prefix[:12]}`."
            raise NoSuchDigest(f"{prefix[:12]} is a version that no gate has judged", hint=hint)
    return resolve_digest(prefix, known, "decision", f"trueup decisions {plant}")


def approve(
    plant: PlantName,
    decision: str,
    *,
    because: Annotated[
        str | None, Parameter(help="Reason; required if the candidate was rejected before")
    ] = None,
    url: Url = DEFAULT_URL,
    as_json_: Json = False,
) -> None:
    """Approve a decision, so that somebody else may promote it where that takes two people.

    Parameters
    ----------
    decision
        digest of the decision, or its first digits
    """
    client = connect_witnessed(url)
    approval = client.approve(plant, _decision(client, plant, decision), because)
    if as_json_:
        as_json(approval)
    else:
        say("approved by {}; somebody else may promote it", approval["actor"])


def rollback(
    plant: PlantName,
    *,
    generation: Generation = None,
    to_generation: Annotated[
        int | None,
        Parameter(help="Older generation whose artifact to serve; default: what served before"),
    ] = None,
    url: Url = DEFAULT_URL,
    as_json_: Json = False,
) -> None:
    """Serve what served before, after its switchback test."""
    client = connect_witnessed(url)
    expected = client.serving(plant).generation if generation is None else generation
    moved = client.roll_back(plant, expected, to_generation=to_generation)
    show_serving([moved], as_json_=as_json_)


def fetch(
    plant: PlantName,
    to: Path,
    *,
    artifact: Annotated[str | None, Parameter(help="Digest; default: what serves")] = None,
    url: Url = DEFAULT_URL,
    as_json_: Json = False,
) -> None:
    """Fetch an artifact into a folder, and verify every byte.

    Parameters
    ----------
    to
        folder to write to, created if it is missing
    """
    client = connect_witnessed(url)
    digest = (
        resolve_artifact(client, plant, artifact) if artifact else client.serving(plant).artifact
    )
    with progress(f"fetch {digest[:12]}"):
        client.fetch(plant, digest, to)
    as_json({"artifact": digest, "folder": str(to)}) if as_json_ else say("{} is in {}", digest, to)


def show_serving(positions: list[Serving], *, as_json_: bool) -> None:
    """Prints positions of a pointer."""
    if as_json_:
        as_json([asdict(s) for s in positions])
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
            for s in positions
        ]
        table("", ["gen.", "version", "artifact", "since (UTC)", "by", "decision", "actor"], rows)
