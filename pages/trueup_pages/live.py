"""What pages say of an entry of the log that somebody else has just made."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from trueup_pages.jobs import name_of

ALARM = "alarm:raised"
WORDS = {
    ALARM: "An alarm was raised",
    "alarm:closed": "An alarm was closed",
    "artifact:added": "A version was added",
    "channel:declared": "A channel was declared",
    "channel:moved": "A channel serves another version",
    "cycle:halted": "The cycle of corrections was halted",
    "decision:approved": "A decision was approved",
    "decision:made": "A gate has decided",
    "episode:ingested": "A recording came in",
    "evidence:added": "Evidence was added",
    "gate:declared": "A gate was declared",
    "label:changed": "A name, tag or note was changed",
    "monitor:calibrated": "A monitor was calibrated",
    "plant:imported": "A plant was imported",
    "plant:registered": "A plant was registered",
    "pointer:moved": "Another version serves",
    "policy:declared": "A policy was declared",
    "project:created": "A project was created",
    "token:issued": "A token was issued",
    "token:revoked": "A token was revoked",
}
JOBS = {
    "job:submitted": "was submitted",
    "job:finished": "has ended",
    "job:cancelled": "was cancelled",
}


def in_words(kind: str, plant: str | None, facts: Mapping[str, Any]) -> str:
    """An entry's kind, with its plant, as a sentence."""
    if kind in JOBS:
        what = f"A {name_of(str(facts.get('kind', 'job')))} {JOBS[kind]}"
    else:
        what = WORDS.get(kind) or f"News of {kind.replace(':', ' ')}"
    return f"{what} on {plant}." if plant else f"{what}."
