"""MCAP: messages of any topic, in chunks or not."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from trueup.episode.container import MAGIC, Limits, Metadata
from trueup.episode.mcap import EPISODE_RECORD
from trueup.episode.walk import Walk
from trueup.recording.format import Format
from trueup.recording.messages import Block, MessageRecording


class Mcap(Format):
    """Source: MCAP format specification, https://mcap.dev/spec (2026)."""

    name = "mcap"
    suffixes = (".mcap",)

    def knows(self, path: Path, head: bytes) -> bool:
        return head.startswith(MAGIC) or path.suffix == ".mcap"

    def recordings(self, path: Path, limits: Limits) -> Sequence[MessageRecording]:
        metadata: list[Metadata] = []

        def blocks() -> Iterator[Block]:
            with path.open("rb") as stream:
                walk = Walk(stream, path.stat().st_size, limits, wanted=(EPISODE_RECORD,))
                for block in walk:
                    yield walk.contents.topics, block
                metadata[:] = walk.contents.metadata

        def declared() -> str | None:
            return metadata[0].values.get("role") if metadata else None

        return [MessageRecording(path.stem, self.name, blocks, declared)]


FORMAT = Mcap()
