"""Cut a part of a recording into an episode of its own, with a role. Messages stay as they were
recorded."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from io import BytesIO
from typing import BinaryIO

from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from trueup.episode.copying import copy_messages
from trueup.episode.mcap import EPISODE_RECORD
from trueup.episode.role import Role


def write_part(
    to: BinaryIO,
    recorded: bytes,
    topics: Collection[str],
    role: Role,
    conditions: Mapping[str, str],
    begin_ns: int | None = None,
    end_ns: int | None = None,
) -> None:
    """Write some topics of a recording, from one log time on and before another [ns], as an
    episode."""
    source = make_reader(BytesIO(recorded))
    writer = Writer(to, compression=CompressionType.ZSTD)
    writer.start(profile=source.get_header().profile, library="trueup")
    copy_messages(source, writer, topics, begin_ns, end_ns)
    writer.add_metadata(EPISODE_RECORD, {"role": str(role), **conditions})
    writer.finish()  # type: ignore[no-untyped-call]
