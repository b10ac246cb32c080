"""Omission: messages of a recording that are left out because they say nothing, and are named."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum

# of a topic's messages: where more say nothing, something else than a lost number is wrong
MOST_OMITTED = 0.1


class Reason(StrEnum):
    """Why messages are left out."""

    NOT_FINITE = "not_finite"
    REPEATED_STAMP = "repeated_stamp"


@dataclass(frozen=True, slots=True)
class Omission:
    """Messages of one topic that were left out for one reason.

    `channel` is the one that has no finite number, None where the whole message is meant; `from_s`
    and `to_s` are the times of the first and the last one [s], on the clock of the episode.
    """

    reason: Reason
    topic: str
    channel: str | None
    messages: int
    from_s: float
    to_s: float

    def since(self, start_ns: int) -> Omission:
        """The omission with times counted from an episode's start [ns]."""
        start_s = start_ns / 1e9
        return replace(self, from_s=self.from_s - start_s, to_s=self.to_s - start_s)


@dataclass(frozen=True, slots=True)
class TopicOffset:
    """How the command topic lies against the observation topic.

    `begin_s` and `end_s` [s]: by how much the first and the last observation are later than the
    first and the last command. `latency_s` [s]: the median time from stamp to log time of
    observations, then of commands, None where messages have no stamps.
    """

    begin_s: float
    end_s: float
    observations: int
    commands: int
    latency_s: tuple[float, float] | None
