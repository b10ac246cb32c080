"""Survey: the topics of a recording, before any of it is declared an episode."""

from __future__ import annotations

from dataclasses import dataclass
from typing import BinaryIO

import numpy as np

from trueup.episode.container import LIMITS, Limits
from trueup.episode.decoders import message_reader
from trueup.episode.joint_state import FIELDS
from trueup.episode.layout import Field
from trueup.episode.mcap import EPISODE_RECORD
from trueup.episode.walk import Walk
from trueup.errors import NotAnEpisode


@dataclass(frozen=True, slots=True)
class Surveyed:
    """A topic of JointState: its joints, the fields that its first message fills, its messages, and
    the median time between them [s].

    `first_ns` and `last_ns` are log times.
    """

    topic: str
    joints: tuple[str, ...]
    fields: tuple[Field, ...]
    messages: int
    period_s: float
    first_ns: int
    last_ns: int


@dataclass(frozen=True, slots=True)
class Survey:
    """Every topic of JointState, the names of the others with their content, and the role that the
    recording declares, if any."""

    topics: tuple[Surveyed, ...]
    others: tuple[str, ...]
    role: str | None


def survey(stream: BinaryIO, size: int, limits: Limits = LIMITS) -> Survey:
    """Survey a recording in one pass. Raises MalformedMcap, TooLarge."""
    walk = Walk(stream, size, limits, wanted=(EPISODE_RECORD,))
    times: dict[int, list[int]] = {}
    firsts: dict[int, bytes] = {}
    for block in walk:
        for channel, messages in block.messages.items():
            start, length, _ = messages[0]
            firsts.setdefault(channel, bytes(block.data[start : start + length]))
            times.setdefault(channel, []).extend(at for *_, at in messages)
    topics, others = [], []
    for channel, first in firsts.items():
        topic = walk.contents.topics[channel]
        try:
            state = message_reader(topic)(first)
        except (NotAnEpisode, ValueError, TypeError, LookupError, AttributeError):
            others.append(f"{topic.name} ({topic.schema.name if topic.schema else topic.encoding})")
            continue
        filled = tuple(
            f
            for f, values in zip(FIELDS, state.values, strict=True)
            if len(values) and np.isfinite(values).all()
        )
        stamps = np.array(times[channel], np.int64)
        period = float(np.median(np.diff(stamps))) / 1e9 if len(stamps) > 1 else 0.0
        topics.append(
            Surveyed(
                topic.name,
                state.names,
                filled,
                len(stamps),
                period,
                int(stamps.min()),
                int(stamps.max()),
            )
        )
    declared = [m.values.get("role") for m in walk.contents.metadata]
    return Survey(tuple(topics), tuple(others), declared[0] if declared else None)
