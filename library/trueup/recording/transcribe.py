"""Transcribe: a recording of any format becomes an episode, kept as MCAP.

The signals that a mapping names are written as JointState on the plant's topics, in the units that
the plant declares, with the times that the original has. A metadata record `source` says what the
file was made from: the original's SHA-256, its format, and the mapping. What the original lacks, is
lacking; what is wrong with it stays wrong, for the episode's own rules to find. A row in which none
of a topic's signals has a value is no sample of that topic.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import BinaryIO

import numpy as np
import orjson
from numpy.typing import NDArray

from trueup.canonical import digest_of
from trueup.episode.columns_writer import ColumnsWriter
from trueup.episode.joint_state import Columns
from trueup.episode.layout import Channel, Layout
from trueup.episode.mcap import EPISODE_RECORD, SOURCE_RECORD
from trueup.episode.role import Role
from trueup.errors import BadMapping
from trueup.recording.format import Run
from trueup.recording.mapping import Part, SignalMapping, Source, matched
from trueup.recording.recording import Recording

HASHED_BYTES = 1 << 20


@dataclass(frozen=True, slots=True)
class Origin:
    """What a transcription was made from: the file's name, its SHA-256, and the part of it."""

    file: str
    sha256: str
    part: str = ""


@dataclass(frozen=True, slots=True)
class _Topic:
    """A topic to write: its channels, the stream that they come from, and for each the column in
    what is read of it, and the factor of its values."""

    name: str
    channels: tuple[Channel, ...]
    stream: str
    columns: tuple[int, ...]
    factors: NDArray[np.float64]

    def of(self, columns: Columns) -> Columns:
        """The rows of the topic among those of its stream."""
        values = columns.values[:, self.columns] * self.factors
        kept = ~np.isnan(values).all(axis=1)
        return Columns(columns.log_ns[kept], columns.stamp_ns[kept], values[kept])


def transcribe(
    recording: Recording,
    mapping: SignalMapping,
    layout: Layout,
    to: BinaryIO,
    *,
    role: Role,
    conditions: Mapping[str, str],
    origin: Origin,
    begin_ns: int | None = None,
    end_ns: int | None = None,
) -> None:
    """Write a recording, from one log time on and before another [ns], as an episode in one pass
    and bounded memory. Raises BadEpisode, BadMapping."""
    mapping.require(recording)
    topics = list(_topics(mapping, layout))
    writer = ColumnsWriter(to, {t.name: t.channels for t in topics})
    shift: int | None = None
    for stream, columns in recording.read(mapping.wanted, mapping.clock):
        if shift is None and len(columns.log_ns):  # no log time of MCAP lies before 1970
            shift = max(0, -int(columns.log_ns.min()))
        part = _between(columns, begin_ns, end_ns)
        for topic in topics:
            if topic.stream == stream:
                rows = topic.of(part)
                writer.add(
                    topic.name,
                    Columns(
                        rows.log_ns + (shift or 0),
                        np.where(rows.stamp_ns == 0, 0, rows.stamp_ns + (shift or 0)),
                        rows.values,
                    ),
                )
    writer.finish(
        {
            EPISODE_RECORD: {"role": str(role), **conditions},
            SOURCE_RECORD: _source(recording, mapping, origin),
        }
    )


def _source(recording: Recording, mapping: SignalMapping, origin: Origin) -> dict[str, str]:
    return {
        "file": origin.file,
        "format": recording.format,
        "sha256": origin.sha256,
        **({"part": origin.part} if origin.part else {}),
        "mapping": orjson.dumps(mapping.document()).decode(),
    }


def _between(columns: Columns, begin_ns: int | None, end_ns: int | None) -> Columns:
    if begin_ns is None and end_ns is None:
        return columns
    kept = np.ones(len(columns.log_ns), bool)
    if begin_ns is not None:
        kept &= columns.log_ns >= begin_ns
    if end_ns is not None:
        kept &= columns.log_ns < end_ns
    return Columns(columns.log_ns[kept], columns.stamp_ns[kept], columns.values[kept])


def _topics(mapping: SignalMapping, layout: Layout) -> Iterator[_Topic]:
    """The topics that an episode of a layout has. Raises BadMapping where a channel that it needs
    has no source."""
    names = {
        Part.OBSERVATIONS: layout.observation_topic,
        Part.COMMANDS: layout.command_topic,
        Part.APPLIED: layout.applied_topic,
        Part.EFFORTS: layout.observation_topic,
    }
    by_topic: dict[str, list[tuple[Channel, Source]]] = {}
    for part, channel, source in matched(mapping, layout):
        if source is not None:
            by_topic.setdefault(names[part], []).append((channel, source))
        elif part is Part.COMMANDS:
            raise BadMapping(
                f"the mapping names no signal for the command {channel.name}", field="commands"
            )
    for name, pairs in by_topic.items():
        yield _topic(name, pairs, mapping)


def _topic(name: str, pairs: Sequence[tuple[Channel, Source]], mapping: SignalMapping) -> _Topic:
    stream = pairs[0][1].stream
    beside = [(c, s) for c, s in pairs if s.stream == stream]
    apart = next((c for c, s in pairs if s.stream != stream and s.part is not Part.EFFORTS), None)
    if apart is not None:
        raise BadMapping(
            f"the channels of {name} come from several topics, {apart.name} among them",
            field="observations",
            hint="Take the positions and velocities of all joints from one topic.",
        )
    read = list(mapping.wanted[stream])
    return _Topic(
        name,
        tuple(c for c, _ in beside),
        stream,
        tuple(read.index(s.signal) for _, s in beside),
        np.array([s.factor_to(c) for c, s in beside]),
    )


def origin_of(path: Path) -> Origin:
    """The origin that a file is, or a folder: of a folder the digest is that of its files'
    digests by their names."""
    if path.is_file():
        return Origin(path.name, _sha256(path))
    files = sorted(p for p in path.rglob("*") if p.is_file())
    digests = {p.relative_to(path).as_posix(): _sha256(p) for p in files}
    return Origin(path.name, digest_of(digests))


def origins_of(runs: Sequence[Run]) -> list[Origin]:
    """The origin of each run; a file or folder of several runs is hashed once."""
    paths = {path: origin_of(path) for path in dict.fromkeys(run.path for run in runs)}
    return [replace(paths[run.path], part=run.part) for run in runs]


def _sha256(path: Path) -> str:
    hashed = hashlib.sha256()
    with path.open("rb") as file:
        while data := file.read(HASHED_BYTES):
            hashed.update(data)
    return hashed.hexdigest()
