"""Tracks: one topic of a recording as stamps and columns, gathered block by block."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueup.episode.container import Message, MessageBlock, Topic
from trueup.episode.decoders import Decoder, decoder
from trueup.episode.joint_state import Columns
from trueup.episode.layout import Channel
from trueup.errors import NotAnEpisode

# one month: a longer episode is a clock that was set while recording
LONGEST_NS = 30 * 24 * 3600 * 1_000_000_000


@dataclass(frozen=True, slots=True)
class Track:
    """Header stamps and log times [ns] `(n,)` and values `(n, channels)` of one topic, in file
    order."""

    topic: str
    channels: tuple[Channel, ...]
    stamp_ns: NDArray[np.int64]
    log_ns: NDArray[np.int64]
    values: NDArray[np.float64]

    @property
    def has_stamps(self) -> bool:
        """Whether any header stamp was set."""
        return bool(self.stamp_ns.any())

    def times_ns(self, *, by_stamp: bool) -> NDArray[np.int64]:
        """The topic's time [ns]. Raises NotAnEpisode (rule `clock`) where it does not increase, or
        spans more than a month."""
        times = self.stamp_ns if by_stamp else self.log_ns
        backward = np.flatnonzero(times[1:] <= times[:-1])
        if len(backward):
            at = int(backward[0]) + 1
            raise self._refused(
                f"message {at} on {self.topic} is not later than the one before it",
                "clock",
                index=at,
                stamp_ns=str(times[at]),
            )
        if int(times[-1]) - int(times[0]) > LONGEST_NS:
            raise self._refused(
                f"{self.topic} spans more than a month: the clock was set while recording",
                "clock",
                index=0,
            )
        return times

    def require_finite(self) -> None:
        """Raises NotAnEpisode (rule `finite`) for a channel that lacks some values, or has one that
        is not a finite number."""
        for column, channel in zip(self.values.T, self.channels, strict=True):
            bad = np.flatnonzero(~np.isfinite(column))
            if len(bad) and not np.isnan(column).all():
                what = (
                    f"message {int(bad[0])} on {self.topic} has no finite {channel.field} "
                    f"for channel {channel.name}"
                )
                raise self._refused(what, "finite", index=int(bad[0]), channel=channel.name)

    def require(self, channels: Sequence[Channel]) -> None:
        """Raises NotAnEpisode (rule `samples`) if the log lacks one of these channels
        altogether."""
        for channel in channels:
            if np.isnan(self.values[:, self.channels.index(channel)]).all():
                what = (
                    f"{self.topic} has no {channel.field} for channel {channel.name}, joint "
                    f"{channel.joint or 'the first'}"
                )
                raise self._refused(
                    what,
                    "samples",
                    channel=channel.name,
                    hint="Name the field and the joint that the log fills in plant.json.",
                )

    def _refused(
        self, what: str, rule: str, *, hint: str | None = None, **facts: object
    ) -> NotAnEpisode:
        return NotAnEpisode(what, hint=hint, rule=rule, topic=self.topic, **facts)


class Gathering:
    """A track that is being read."""

    def __init__(self, topic: str, channels: tuple[Channel, ...]) -> None:
        self.topic = topic
        self._channels = channels
        self._decoders: dict[int, Decoder] = {}
        self._parts: list[Columns] = []

    def add(self, topic: Topic, block: MessageBlock, messages: list[Message]) -> None:
        """Decode the topic's messages of one block."""
        if topic.id not in self._decoders:
            if self._decoders:
                raise NotAnEpisode(
                    f"topic {self.topic} is recorded on two channels; keep one",
                    rule="topic",
                    topic=self.topic,
                )
            self._decoders[topic.id] = decoder(topic)
        self._parts.append(self._decoders[topic.id](block, messages, self._channels))

    def __bool__(self) -> bool:
        """Whether there was any message."""
        return bool(self._parts)

    def track(self, known: Sequence[str]) -> Track:
        """The whole track. Raises NotAnEpisode (rule `topic`) if it has no message. `known` are the
        recording's topics."""
        if not self._parts:
            topics = ", ".join(known) or "none"
            raise NotAnEpisode(
                f"the recording has no message on {self.topic}; its topics are: {topics}",
                rule="topic",
                topic=self.topic,
            )
        columns = (
            np.concatenate([getattr(p, name) for p in self._parts])
            for name in ("stamp_ns", "log_ns", "values")
        )
        return Track(self.topic, self._channels, *columns)
