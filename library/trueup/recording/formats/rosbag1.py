"""ROS 1 bags: `*.bag`, whose container `rosbags` reads."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from trueup.episode.container import Limits, Schema, Topic
from trueup.errors import MalformedRecording, NotAnEpisode, TooLarge
from trueup.recording.format import Format, optional
from trueup.recording.messages import Block, MessageRecording, gathered

MAGIC = b"#ROSBAG V2.0"


class RosBag1(Format):
    """A bag of ROS 1, version 2.0."""

    name = "rosbag1"
    suffixes = (".bag",)

    def knows(self, path: Path, head: bytes) -> bool:
        return head.startswith(MAGIC) or path.suffix == ".bag"

    def recordings(self, path: Path, limits: Limits) -> Sequence[MessageRecording]:
        reader = optional("rosbags.rosbag1", "ros", "a ROS 1 bag").Reader

        def blocks() -> Iterator[Block]:
            try:
                with reader(path) as bag:
                    topics: dict[int, Topic] = {}
                    yield from gathered(topics, _messages(bag, topics))
            except (NotAnEpisode, TooLarge):
                raise
            except Exception as error:  # the reader's errors share no public base
                raise MalformedRecording(
                    f"{path.name} cannot be read as a bag: {error}", rule="container"
                ) from error

        return [MessageRecording(path.stem, self.name, blocks)]


def _messages(bag: Any, topics: dict[int, Topic]) -> Iterator[tuple[int, int, bytes]]:
    """Every message: its connection, time [ns] and data; `topics` gets each connection's topic."""
    for connection, timestamp, data in bag.messages():
        if connection.id not in topics:
            text = str(connection.msgdef.data).encode()
            schema = Schema(connection.id + 1, connection.msgtype, "ros1msg", text)
            topics[connection.id] = Topic(connection.id, schema, connection.topic, "ros1", {})
        yield connection.id, timestamp, data


FORMAT = RosBag1()
