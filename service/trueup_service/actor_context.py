"""The actor of a change and its time, which every action and every entry of the log takes."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime

END_OF_TIME = "9999-12-31T23:59:59.999999Z"


@dataclass(frozen=True, slots=True)
class ActorContext:
    """The actor of a change as the log names it, the time of the change as the registry writes it,
    and the public prefix of the actor's token, empty where there is none."""

    actor: str
    now: str
    token: str = ""


def time_text(at: datetime) -> str:
    """A time as the registry writes it: UTC, ISO 8601 with microseconds, so that the order of the
    text is the order of time."""
    return at.astimezone(UTC).strftime("%Y-%m-%dT%H:%M:%S.%fZ")
