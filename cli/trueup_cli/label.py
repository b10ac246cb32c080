"""`trueup label`: what people call plants, episodes, versions and decisions."""

from __future__ import annotations

from typing import Annotated

from cyclopts import Parameter

from trueup_cli.digests import resolve_digest
from trueup_cli.options import DEFAULT_URL, Json, PlantName, Url, connect
from trueup_cli.registry import resolve_artifact, resolve_episode
from trueup_cli.show import as_json, say, table
from trueup_client import Client
from trueup_client.records import Label

Tags = Annotated[tuple[str, ...], Parameter(negative=())]


def label(
    plant: PlantName,
    *,
    episode: Annotated[str | None, Parameter(help="Label an episode: its first digits")] = None,
    version: Annotated[str | None, Parameter(help="Label a version: its number")] = None,
    decision: Annotated[str | None, Parameter(help="Label a decision: its first digits")] = None,
    name: Annotated[str | None, Parameter(help="What it is called; '' takes it away")] = None,
    tag: Annotated[Tags, Parameter(help="Give it a tag; several times for several")] = (),
    untag: Annotated[Tags, Parameter(help="Take a tag away")] = (),
    note: Annotated[str | None, Parameter(help="What is to be known of it; '' clears it")] = None,
    tagged: Annotated[str | None, Parameter(help="List only what has this tag")] = None,
    url: Url = DEFAULT_URL,
    as_json_: Json = False,
) -> None:
    """Give a plant, an episode, a version or a decision a name, tags and a note; or list them.

    Without --episode, --version or --decision it is the plant itself that is labelled. With
    nothing to change, the labels of the plant are listed. They change nothing that is judged.
    """
    client = connect(url)
    kind, subject = _subject(client, plant, episode, version, decision)
    if name is None and note is None and not tag and not untag:
        of = None if kind == "plant" else kind
        listed = [
            one
            for one in client.labels(plant, of, tagged)
            if kind == "plant" or one["subject"] == subject
        ]
        as_json(listed) if as_json_ else _show(client, plant, listed)
        return
    before = client.label(plant, kind, subject)["tags"] if tag or untag else []
    tags = (
        [t for t in dict.fromkeys([*before, *map(_kept, tag)]) if t not in map(_kept, untag)]
        if tag or untag
        else None
    )
    made = client.change_label(plant, kind, subject, name=name, tags=tags, note=note)
    as_json(made) if as_json_ else _show(client, plant, [made])


def _kept(tag: str) -> str:
    """Returns a tag as the service keeps it."""
    return " ".join(tag.lower().split())


def _subject(
    client: Client, plant: str, episode: str | None, version: str | None, decision: str | None
) -> tuple[str, str]:
    """Returns what is labelled: its kind and what names it. Raises NoSuchDigest."""
    if episode is not None:
        return "episode", resolve_episode(client, plant, episode)
    if version is not None:
        return "version", resolve_artifact(client, plant, version)
    if decision is not None:
        decided = client.decisions(plant)
        return "decision", resolve_digest(
            decision, decided, "decision", f"trueup decisions {plant}"
        )
    return "plant", plant


def _show(client: Client, plant: str, labels: list[Label]) -> None:
    if not labels:
        say("nothing that was asked for has a label: trueup label {} --name NAME", plant)
        return
    numbers = {a["digest"]: f"version {a['version']}" for a in client.artifacts(plant)}
    table(
        "",
        ["what", "name", "tags", "note"],
        [
            (
                one["kind"]
                if one["kind"] == "plant"
                else numbers.get(one["subject"], f"{one['kind']} {one['subject'][:12]}"),
                one["name"] or "",
                ", ".join(one["tags"]),
                (one["note"] or "").partition("\n")[0],
            )
            for one in labels
        ],
    )
