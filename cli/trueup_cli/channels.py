"""Commands on evidence, and on the channels of serving that require it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from trueup.gate.evidence import BadEvidence
from trueup_cli.options import DEFAULT_URL, Json, PlantName, Url, connect, read_json, witnessed
from trueup_cli.show import as_json, moment, say, table
from trueup_client import Client, Problem
from trueup_client.records import ChannelPosition

Artifact = Annotated[str | None, Parameter(help="Digest; default: what serves")]


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
    """List what was found of a version and at which stage (MIL, SIL, PIL, HIL, physical), or add to
    it."""
    client = connect(url)
    of = artifact or client.serving(plant).artifact
    if add is not None:
        document = read_json(add, BadEvidence)
        of = document.get("artifact", of) if artifact is None else of
        client.add_evidence(plant, {**document, "artifact": of})
    found = client.evidence(plant, of)
    if as_json_:
        as_json(found)
        return
    if not found:
        say("no evidence of {} yet", of[:12])
        return
    rows = [
        (
            e["stage"],
            "passed" if e["passed"] else "failed",
            moment(e["created_at"]),
            e["created_by"],
            e["document"]["shows"],
        )
        for e in found
    ]
    table(f"Evidence of {of[:12]}", ["stage", "", "at", "by", "shows"], rows)
    for e in found:
        say("[dim]{} cannot show: {}[/]", e["stage"], e["document"]["cannot_show"])


def channels(
    plant: PlantName,
    *,
    declare: Annotated[str | None, Parameter(help="Name of a new channel, such as field")] = None,
    requires: Annotated[
        str,
        Parameter(
            help="Comma-separated stages whose passed evidence it requires, once and for all"
        ),
    ] = "",
    url: Url = DEFAULT_URL,
    as_json_: Json = False,
) -> None:
    """Say what each channel serves and which stages it requires, or declare one."""
    client = connect(url)
    if declare is not None:
        client.declare_channel(
            plant, declare, [s.strip() for s in requires.split(",") if s.strip()]
        )
    found = [(c, _position(client, plant, c["name"])) for c in client.channels(plant)]
    if as_json_:
        as_json([{**c, "serving": position} for c, position in found])
        return
    rows = [
        (c["name"], ", ".join(c["requires"]) or "nothing", *_row(position)) for c, position in found
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
    """Serve a version on a channel: what serves the plant, or another one that did, with passed
    evidence of the stages required.

    Parameters
    ----------
    channel
        name of the channel
    """
    client = witnessed(url)
    before = _position(client, plant, channel)
    moved = client.move_channel(
        plant,
        channel,
        artifact or client.serving(plant).artifact,
        before["generation"] if before else 0,
    )
    if as_json_:
        as_json(moved)
    else:
        say(
            "{} serves version {} of {}, generation {}",
            channel,
            moved["version"],
            plant,
            moved["generation"],
        )


def _position(client: Client, plant: str, channel: str) -> ChannelPosition | None:
    """Where a channel stands, None if it has served nothing; any other refusal is raised."""
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
