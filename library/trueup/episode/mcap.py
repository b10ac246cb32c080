"""MCAP to Episode.

Rules of an episode, each named in the NotAnEpisode that it raises:
- role: one metadata record `episode` carries a role that we know, and the collection conditions, a
  page of text at most;
- topic: the plant's observation topic and command topic are there, each on one channel; a topic of
  applied commands may be there, too;
- encoding: each carries JointState, as CDR, JSON or protobuf; message: and every message is one;
- clock: header stamps count where all topics have them, log times otherwise; they strictly
  increase, and they overlap;
- samples: two aligned samples at least, every command and every declared position among them;
- finite: a value is finite, or its whole channel is missing; a few messages that break this, or
  repeat a stamp, are left out and named.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from io import BytesIO
from typing import BinaryIO, cast

from trueup.episode.align import align
from trueup.episode.clocks import doubts
from trueup.episode.container import LIMITS, Limits, Metadata
from trueup.episode.episode import Episode
from trueup.episode.layout import Layout
from trueup.episode.role import Role, role_named
from trueup.episode.track import Gathering
from trueup.episode.walk import Walk
from trueup.errors import NotAnEpisode, TooLarge

EPISODE_RECORD = "episode"
SOURCE_RECORD = "source"  # of an episode that was made from a file of another format
# entries, and characters of them all: every listing and audit entry repeats them
CONDITIONS, CONDITION_CHARACTERS = (64, 4096)


def read_episode(data: bytes, layout: Layout, limits: Limits = LIMITS) -> Episode:
    """The episode that a whole MCAP file in memory holds. Raises BadEpisode."""
    return read_episode_stream(BytesIO(data), len(data), layout, limits)


def read_episode_stream(
    stream: BinaryIO, size: int, layout: Layout, limits: Limits = LIMITS, *, late_s: float = 0.0
) -> Episode:
    """The episode in a stream of `size` bytes, read once, chunk by chunk; its observations happened
    `late_s` [s] before their stamps. Raises BadEpisode."""
    hashed = _Hashed(stream)
    walk = Walk(cast(BinaryIO, hashed), size, limits, wanted=(EPISODE_RECORD, SOURCE_RECORD))
    tracks = (
        Gathering(layout.observation_topic, layout.observations),
        Gathering(layout.command_topic, layout.commands),
        Gathering(layout.applied_topic, layout.commands),
        Gathering(layout.observation_topic, layout.efforts),
    )
    for block in walk:
        for channel, messages in block.messages.items():
            topic = walk.contents.topics[channel]
            for track in tracks:
                if topic.name == track.topic:
                    track.add(topic, block, messages)
    role, conditions = _role(_named(walk.contents.metadata, EPISODE_RECORD))
    sources = _named(walk.contents.metadata, SOURCE_RECORD)
    known = sorted({t.name for t in walk.contents.topics.values()})
    observed, issued = (track.track(known) for track in tracks[:2])
    applied = tracks[2].track(known) if tracks[2] else None
    effort = tracks[3].track(known).values
    aligned = align(observed, issued, applied, effort, round(1e9 * late_s))
    amiss = doubts(observed) + (doubts(issued) if issued.topic != observed.topic else ())
    start = int(aligned.stamps[0])
    return Episode(
        (aligned.stamps - start) / 1e9,
        aligned.commands,
        aligned.observations,
        layout,
        role,
        conditions,
        start,
        hashed.digest,
        amiss,
        aligned.applied,
        tuple(o.since(start) for o in aligned.omissions),
        aligned.offset,
        effort=aligned.effort,
        source=dict(sources[0].values) if sources else {},
    )


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


def _named(records: Sequence[Metadata], name: str) -> list[Metadata]:
    return [r for r in records if r.name == name]


def _role(records: Sequence[Metadata]) -> tuple[Role, dict[str, str]]:
    if len(records) != 1:
        raise NotAnEpisode(
            f"{len(records)} metadata records are named `{EPISODE_RECORD}`, one is needed",
            rule="role",
        )
    conditions = dict(records[0].values)
    if (
        len(conditions) > CONDITIONS
        or sum(len(k) + len(v) for k, v in conditions.items()) > CONDITION_CHARACTERS
    ):
        limit = f"{CONDITIONS} entries of {CONDITION_CHARACTERS} characters together"
        raise TooLarge(
            f"the metadata record `{EPISODE_RECORD}` holds more than {limit}",
            limit="conditions",
            byte=0,
        )
    return role_named(conditions.pop("role", "")), conditions
