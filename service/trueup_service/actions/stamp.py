"""Who does something, and when."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime

END_OF_TIME = "9999-12-31T23:59:59.999999Z"


@dataclass(frozen=True, slots=True)
class Stamp:
    """The actor of a change, its time as the registry writes it, and the token that the actor came
    with."""

    actor: str
    now: str
    token: str = ""


def time_text(at: datetime) -> str:
    """UTC, ISO 8601, microseconds: text order is time order."""
    return at.astimezone(UTC).strftime("%Y-%m-%dT%H:%M:%S.%fZ")
