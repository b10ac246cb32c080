"""The record of a label. Its fields are the columns of its table."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Labelled(StrEnum):
    """What people can give a name, tags and a note."""

    PLANT = "plant"
    EPISODE = "episode"
    VERSION = "version"
    DECISION = "decision"


@dataclass(frozen=True, slots=True)
class LabelRecord:
    """What people call something of a plant: a name, tags and a note. The subject is the name of
    the plant, or the digest of an episode, an artifact or a decision."""

    plant: str
    kind: str
    subject: str
    name: str | None
    tags: list[str]
    note: str | None
    updated_at: str
    updated_by: str
