"""Who does something, and when."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime


@dataclass(frozen=True, slots=True)
class Stamp:
    """The actor of a change, and its time as the registry writes it."""

    actor: str
    now: str


def time_text(at: datetime) -> str:
    """UTC, ISO 8601, microseconds: text order is time order."""
    return at.astimezone(UTC).strftime("%Y-%m-%dT%H:%M:%S.%fZ")
