"""Logs of messages: a recording with a stream for each topic, from blocks of messages.

MCAP files, SQLite bags and ROS 1 bags give their messages in the same blocks; how a message is read
depends on its topic's encoding alone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from trueup.episode.container import Loose, MessageBlock, Topic
from trueup.episode.joint_state import Columns
from trueup.errors import NotAnEpisode, NotInstalled
from trueup.recording.recording import Clock, Recording, Signal, Span, Stream, Wanted
from trueup.recording.topic_reader import UNREADABLE, TopicReader, topic_reader

# Topics by their id, as far as they are known yet, and the messages of one block
Block = tuple[Mapping[int, Topic], MessageBlock]
Blocks = Callable[[], Iterator[Block]]
LOOKED_AT = 50  # messages of a topic: several nodes may publish joints of their own on it
BLOCK_BYTES = 1 << 20  # of messages that are read together


def gathered(
    topics: Mapping[int, Topic], messages: Iterable[tuple[int, int, bytes]]
) -> Iterator[Block]:
    """Messages, each with its topic's id and its log time [ns], as blocks; reading them may add to
    `topics`."""
    loose = Loose()
    for topic, log_ns, data in messages:
        loose.add(topic, data, log_ns, 0)
        if loose.size >= BLOCK_BYTES:
            yield topics, loose.block()
            loose = Loose()
    if loose.size:
        yield topics, loose.block()


class MessageRecording(Recording):
    """A recording of the messages that `blocks` reads; `declared` says what role the log declares,
    once it was read to its end."""

    def __init__(
        self,
        name: str,
        format_: str,
        blocks: Blocks,
        declared: Callable[[], str | None] = lambda: None,
    ) -> None:
        self.name, self.format = name, format_
        self._blocks, self._declared = blocks, declared

    @property
    def streams(self) -> tuple[Stream, ...]:
        return self._survey.streams

    @property
    def role(self) -> str | None:
        return self._survey.role

    @property
    def unread(self) -> dict[str, str]:
        """Topics without any signal that can be read, and why."""
        return self._survey.unread

    def span(self, stream: str, clock: Clock | None) -> Span:
        return self._survey.spans[stream]

    @cached_property
    def _survey(self) -> _Survey:
        """One pass over the whole log, of which the first messages of each topic are read."""
        survey, readers = _Survey(), _Readers()
        signals: dict[str, dict[str, Signal]] = {}
        kinds: dict[str, str] = {}
        for topics, block in self._blocks():
            for channel, messages in block.messages.items():
                topic, times = topics[channel], [at for *_, at in messages]
                kinds.setdefault(topic.name, topic.schema.name if topic.schema else topic.encoding)
                before = survey.spans.get(topic.name, Span(times[0], times[0], 0))
                survey.spans[topic.name] = before.with_times(times)
                for start, length, _ in messages[: max(0, LOOKED_AT - before.rows)]:
                    try:
                        more = readers.of(topic).signals(block.data[start : start + length])
                    except (*UNREADABLE, NotAnEpisode, NotInstalled) as error:
                        survey.unread[topic.name] = str(error)
                        continue
                    signals.setdefault(topic.name, {}).update(more)
        for name in kinds:
            if not signals.get(name):
                survey.unread.setdefault(name, "its messages hold no numbers")
        survey.streams = tuple(
            Stream(name, kinds[name], tuple(of.values()), True)
            for name, of in signals.items()
            if of
        )
        survey.role = self._declared()
        return survey

    def read(self, wanted: Wanted, clock: Clock | None) -> Iterator[tuple[str, Columns]]:
        readers = _Readers()
        trajectories = {name: _Trajectory() for name in wanted}
        for topics, block in self._blocks():
            for channel, messages in block.messages.items():
                name = topics[channel].name
                if name not in wanted:
                    continue
                columns = readers.of(topics[channel]).columns(block, messages, wanted[name])
                yield name, trajectories[name].settled(columns, [at for *_, at in messages])
        for name, trajectory in trajectories.items():
            if (rest := trajectory.rest) is not None:
                yield name, rest


@dataclass(slots=True)
class _Survey:
    streams: tuple[Stream, ...] = ()
    spans: dict[str, Span] = field(default_factory=dict)
    unread: dict[str, str] = field(default_factory=dict)
    role: str | None = None


class _Readers:
    """The readers of topics, each made once."""

    def __init__(self) -> None:
        self._readers: dict[int, TopicReader] = {}

    def of(self, topic: Topic) -> TopicReader:
        """The reader of a topic. Raises NotAnEpisode, NotInstalled."""
        if topic.id not in self._readers:
            reader = topic_reader(topic)
            if reader is None:
                raise NotAnEpisode(
                    f"topic {topic.name} is encoded as {topic.encoding!r}; cdr, ros1, json and "
                    "protobuf are read",
                    rule="encoding",
                    topic=topic.name,
                )
            self._readers[topic.id] = reader
        return self._readers[topic.id]


class _Trajectory:
    """Points of trajectories that are still to come. A new trajectory takes the place of what is
    left of the one before; of other messages nothing is ever to come."""

    def __init__(self) -> None:
        self.rest: Columns | None = None

    def settled(self, columns: Columns, sent_ns: list[int]) -> Columns:
        """The rows that no later message changes; the others wait."""
        if self.rest is None and len(columns.log_ns) == len(sent_ns):
            return columns  # one row a message
        if self.rest is not None:
            columns = _joined(self.rest, columns)
        # a point is overtaken where any later one is due no later than it
        due = columns.log_ns
        earliest_after = np.minimum.accumulate(np.append(due[1:], np.iinfo(np.int64).max)[::-1])
        columns = _where(columns, due < earliest_after[::-1])
        waits = columns.log_ns > max(sent_ns)
        self.rest = _where(columns, waits) if waits.any() else None
        return _where(columns, ~waits)


def _where(columns: Columns, which: NDArray[np.bool_]) -> Columns:
    return Columns(columns.log_ns[which], columns.stamp_ns[which], columns.values[which])


def _joined(first: Columns, second: Columns) -> Columns:
    return Columns(
        np.concatenate([first.log_ns, second.log_ns]),
        np.concatenate([first.stamp_ns, second.stamp_ns]),
        np.concatenate([first.values, second.values]),
    )
