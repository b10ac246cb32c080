"""Commands on evidence, and on the serving channels that require it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from trueup.gate.evidence import BadEvidence
from trueup_cli.options import (
    DEFAULT_URL,
    Json,
    PlantName,
    Url,
    connect,
    connect_witnessed,
    read_json,
)
from trueup_cli.registry import resolve_artifact
from trueup_cli.show import as_json, moment, say, table
from trueup_client import Client, Problem
from trueup_client.records import ChannelPosition

Artifact = Annotated[
    str | None, Parameter(help="Digest, or its first digits; default: what serves")
]


def evidence(
    plant: PlantName,
    *,
    artifact: Artifact = None,
    add: Annotated[
        Path | None, Parameter(help="JSON file: stage, passed, shows, cannot_show, figures")
    ] = None,
    url: Url = DEFAULT_URL,
    as_json_: Json = False,
) -> None:
    """List the evidence on a version by stage (MIL, SIL, PIL, HIL, physical), or add to it."""
    client = connect(url)
    digest = _artifact(client, plant, artifact)
    if add is not None:
        document = read_json(add, BadEvidence)
        digest = document.get("artifact", digest) if artifact is None else digest
        client.add_evidence(plant, {**document, "artifact": digest})
    listed = client.evidence(plant, digest)
    if as_json_:
        as_json(listed)
        return
    if not listed:
        say("no evidence of {} yet", digest[:12])
        return
    rows = [
        (
            e["stage"],
            "passed" if e["passed"] else "failed",
            moment(e["created_at"]),
            e["created_by"],
            e["document"]["shows"],
        )
        for e in listed
    ]
    table(f"Evidence of {digest[:12]}", ["stage", "", "at", "by", "shows"], rows)
    for e in listed:
        say("[dim]{} cannot show: {}[/]", e["stage"], e["document"]["cannot_show"])


def channels(
    plant: PlantName,
    *,
    declare: Annotated[str | None, Parameter(help="Name of a new channel, such as field")] = None,
    requires: Annotated[
        str,
        Parameter(
            help="Comma-separated stages whose passed evidence it requires; cannot be changed later"
        ),
    ] = "",
    url: Url = DEFAULT_URL,
    as_json_: Json = False,
) -> None:
    """Show what each channel serves and which stages it requires, or declare a channel."""
    client = connect(url)
    if declare is not None:
        client.declare_channel(
            plant, declare, [s.strip() for s in requires.split(",") if s.strip()]
        )
    listed = [(c, _position(client, plant, c["name"])) for c in client.channels(plant)]
    if as_json_:
        as_json([{**c, "serving": position} for c, position in listed])
        return
    rows = [
        (c["name"], ", ".join(c["requires"]) or "nothing", *_row(position))
        for c, position in listed
    ]
    if rows:
        table(
            "Channels", ["channel", "requires", "gen.", "version", "artifact", "since (UTC)"], rows
        )
    else:
        say(
            "no channels: `trueup channels PLANT --declare field --requires MIL,physical` makes one"
        )


def release(
    plant: PlantName,
    channel: str,
    *,
    artifact: Artifact = None,
    url: Url = DEFAULT_URL,
    as_json_: Json = False,
) -> None:
    """Serve a version on a channel; by default the one that serves the plant.

    The version must have served the plant, and have passed evidence of the required stages.

    Parameters
    ----------
    channel
        name of the channel
    """
    client = connect_witnessed(url)
    before = _position(client, plant, channel)
    position = client.move_channel(
        plant,
        channel,
        _artifact(client, plant, artifact),
        before["generation"] if before else 0,
    )
    if as_json_:
        as_json(position)
    else:
        say(
            "{} serves version {} of {}, generation {}",
            channel,
            position["version"],
            plant,
            position["generation"],
        )


def _artifact(client: Client, plant: str, name: str | None) -> str:
    """Returns the digest of a version, by default of the one that serves. Raises NoSuchDigest."""
    if name is None:
        return client.serving(plant).artifact
    return resolve_artifact(client, plant, name)


def _position(client: Client, plant: str, channel: str) -> ChannelPosition | None:
    """Returns what a channel serves; None if it has served nothing. Raises Problem."""
    try:
        return client.channel_serving(plant, channel)
    except Problem as refused:
        if refused.facts.get("noun") != "position":
            raise
        return None


def _row(position: ChannelPosition | None) -> tuple[Any, ...]:
    if position is None:
        return "", "", "nothing yet", ""
    return (
        position["generation"],
        position["version"],
        position["artifact"][:12],
        moment(position["at"]),
    )
