"""MCAP to Episode and back.

Rules of an episode, each named in the NotAnEpisode that it raises:
- role: one metadata record `episode` carries a role that we know, and the collection conditions;
- topic: the plant's observation topic and command topic are there, each in one encoding;
- clock: header stamps count, or log times where every stamp is zero; they strictly increase on each topic;
- command: a command acts from its stamp on; samples before the first command are dropped;
- samples: two aligned samples at least, and some declared observation among them;
- finite: a value is finite, or its whole channel is missing.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from io import BytesIO
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from trueup.episode.container import LIMITS, Block, Limits, Message, Metadata, Topic, Walk
from trueup.episode.episode import Episode
from trueup.episode.joint_state import Columns, Decoder, decoder
from trueup.episode.layout import Channel, Layout
from trueup.episode.role import Role
from trueup.errors import NotAnEpisode

Track = tuple[NDArray[np.int64], NDArray[np.float64]]


def read_episode(data: bytes, layout: Layout, limits: Limits = LIMITS) -> Episode:
    """The episode that a whole MCAP file in memory holds. Raises BadEpisode."""
    return read_episode_stream(BytesIO(data), len(data), layout, limits)


def read_episode_stream(stream: BinaryIO, size: int, layout: Layout, limits: Limits = LIMITS) -> Episode:
    """The episode in a stream of `size` bytes, read once, chunk by chunk. Raises BadEpisode."""
    hashed = _Hashed(stream)
    walk = Walk(hashed, size, limits)  # type: ignore[arg-type]
    observed = _Collector(layout.observation_topic, layout.observations)
    issued = _Collector(layout.command_topic, layout.commands)
    for block in walk:
        for channel, messages in block.messages.items():
            topic = walk.contents.topics[channel]
            for collector in (observed, issued):
                if topic.name == collector.topic:
                    collector.add(topic, block, messages)
    role, conditions = _role(walk.contents.metadata)
    known = sorted({t.name for t in walk.contents.topics.values()})
    return _align(observed.columns(known), issued.columns(known), layout, role, conditions, hashed.digest)


class _Hashed:
    """A stream that hashes what is read from it."""

    def __init__(self, stream: BinaryIO) -> None:
        self._stream, self._hash = stream, hashlib.sha256()

    def read(self, length: int) -> bytes:
        data = self._stream.read(length)
        self._hash.update(data)
        return data

    @property
    def digest(self) -> str:
        return self._hash.hexdigest()


class _Collector:
    """The columns of one topic, block by block."""

    def __init__(self, topic: str, channels: Sequence[Channel]) -> None:
        self.topic = topic
        self._channels = channels
        self._decoders: dict[int, Decoder] = {}
        self._parts: list[Columns] = []

    def add(self, topic: Topic, block: Block, messages: list[Message]) -> None:
        if topic.id not in self._decoders:
            if self._decoders:
                raise NotAnEpisode(f"topic {self.topic} is recorded on two channels; keep one", rule="topic", topic=self.topic)
            self._decoders[topic.id] = decoder(topic)
        self._parts.append(self._decoders[topic.id](block, messages, self._channels))

    def columns(self, known: Sequence[str]) -> Track:
        """Stamps [ns] and values of the whole topic."""
        if not self._parts:
            raise NotAnEpisode(
                f"the recording has no message on {self.topic}; its topics are: {', '.join(known) or 'none'}",
                rule="topic",
                topic=self.topic,
            )
        stamps = np.concatenate([p.stamp_ns for p in self._parts])
        if not stamps.any():
            stamps = np.concatenate([p.log_ns for p in self._parts])
        backward = np.flatnonzero(np.diff(stamps) <= 0)
        if len(backward):
            at = int(backward[0]) + 1
            raise NotAnEpisode(
                f"message {at} on {self.topic} is not later than the one before it",
                rule="clock",
                topic=self.topic,
                index=at,
                stamp_ns=str(stamps[at]),
            )
        return stamps, np.concatenate([p.values for p in self._parts])


def _role(found: Sequence[Metadata]) -> tuple[Role, dict[str, str]]:
    named = [m.values for m in found if m.name == "episode"]
    if len(named) != 1:
        raise NotAnEpisode(f"{len(named)} metadata records are named `episode`, one is needed", rule="role")
    conditions = dict(named[0])
    role = conditions.pop("role", "")
    if role not in set(Role):
        raise NotAnEpisode(f"the role {role!r} is none of {', '.join(Role)}", rule="role")
    return Role(role), conditions


def _align(observed: Track, issued: Track, layout: Layout, role: Role, conditions: dict[str, str], digest: str) -> Episode:
    stamps, observations = observed
    command_stamps, commands = issued
    _finite(observations, layout.observations, layout.observation_topic)
    _finite(commands, layout.commands, layout.command_topic)
    if np.isnan(observations).all():
        raise NotAnEpisode(
            f"{layout.observation_topic} holds none of the declared observations", rule="samples", topic=layout.observation_topic
        )
    held = np.searchsorted(command_stamps, stamps, side="right") - 1
    kept = held >= 0
    stamps = stamps[kept]
    start = int(stamps[0]) if len(stamps) else 0
    return Episode((stamps - start) / 1e9, commands[held[kept]], observations[kept], layout, role, conditions, start, digest)


def _finite(values: NDArray[np.float64], channels: Sequence[Channel], topic: str) -> None:
    for column, channel in zip(values.T, channels, strict=True):
        bad = np.flatnonzero(~np.isfinite(column))
        if len(bad) and len(bad) < len(column):
            raise NotAnEpisode(
                f"message {int(bad[0])} on {topic} has no finite {channel.field} for channel {channel.name}",
                rule="finite",
                topic=topic,
                index=int(bad[0]),
                channel=channel.name,
            )
