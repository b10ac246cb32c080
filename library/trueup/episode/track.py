"""Tracks: one topic of a recording as stamps and columns, gathered block by block."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trueup.episode.container import Message, MessageBlock, Topic
from trueup.episode.decoders import Decoder, decoder
from trueup.episode.joint_state import Columns
from trueup.episode.layout import Channel
from trueup.episode.omission import MOST_OMITTED, Omission, Reason
from trueup.errors import NotAnEpisode

# one month: a longer episode is a clock that was set while recording
LONGEST_NS = 30 * 24 * 3600 * 1_000_000_000
NS_PER_S = 1e9


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

    def kept(self, *, by_stamp: bool) -> tuple[Track, tuple[Omission, ...]]:
        """The track without messages that say nothing, and what was left out.

        Left out are messages in which a channel has no finite number, although it has one in
        others, and messages that repeat the time of the one before. Raises NotAnEpisode (rules
        `finite` and `clock`) where that is more than `MOST_OMITTED` of the topic.
        """
        times = self.stamp_ns if by_stamp else self.log_ns
        broken, repeats = self._flaws(by_stamp=by_stamp)
        omissions = [
            self._omission(Reason.NOT_FINITE, column, times, channel)
            for column, channel in zip(broken.T, self.channels, strict=True)
        ]
        omissions.append(self._omission(Reason.REPEATED_STAMP, repeats, times, None))
        good = self.says_something(by_stamp=by_stamp)
        kept = replace(
            self,
            stamp_ns=self.stamp_ns[good],
            log_ns=self.log_ns[good],
            values=self.values[good],
        )
        return kept, tuple(o for o in omissions if o is not None)

    def says_something(self, *, by_stamp: bool) -> NDArray[np.bool_]:
        """Which messages have a finite number of every channel that has any, and a time other than
        that of the one before, `(n,)`."""
        broken, repeats = self._flaws(by_stamp=by_stamp)
        return np.asarray(~(broken.any(axis=1) | repeats))

    def _flaws(self, *, by_stamp: bool) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Which values are not finite although their channel has others that are, `(n, channels)`,
        and which messages repeat the time of the one before, `(n,)`."""
        times = self.stamp_ns if by_stamp else self.log_ns
        has_values = ~np.isnan(self.values).all(axis=0)
        return ~np.isfinite(self.values) & has_values, np.append(False, np.diff(times) == 0)

    def _omission(
        self,
        reason: Reason,
        which: NDArray[np.bool_],
        times: NDArray[np.int64],
        channel: Channel | None,
    ) -> Omission | None:
        """What is left out for one reason, None where nothing is. Raises NotAnEpisode where it is
        too much."""
        index = np.flatnonzero(which)
        if not len(index):
            return None
        first = int(index[0])
        if len(index) > MOST_OMITTED * len(which):
            if channel is None:
                what = f"message {first} on {self.topic} is not later than the one before it"
                raise self._refused(what, "clock", index=first, stamp_ns=str(times[first]))
            raise self._refused(
                f"message {first} on {self.topic} has no finite {channel.field} "
                f"for channel {channel.name}, nor have {len(index) - 1} others of {len(which)}",
                "finite",
                index=first,
                channel=channel.name,
            )
        return Omission(
            reason,
            self.topic,
            channel.name if channel else None,
            len(index),
            int(times[first]) / NS_PER_S,
            int(times[index[-1]]) / NS_PER_S,
        )

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
