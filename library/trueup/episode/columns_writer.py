"""Write columns of samples as an MCAP file of JointState messages, block by block."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import BinaryIO

import numpy as np
from mcap.writer import CompressionType, Writer
from numpy.typing import NDArray

from trueup.episode.cdr import cdr_shape
from trueup.episode.joint_state import Columns
from trueup.episode.layout import Channel
from trueup.episode.writer import ROS2_DEFINITION, UNNAMED, FieldColumns, encode_cdr

NS_PER_S = 1_000_000_000
STAMP_AT = 4  # where the stamp stands in a message [bytes]: its seconds, then its nanoseconds


class ColumnsWriter:
    """Writes topics of JointState, each with its channels, in ROS 2 CDR."""

    def __init__(self, to: BinaryIO, topics: Mapping[str, Sequence[Channel]]) -> None:
        self._writer = Writer(to, compression=CompressionType.ZSTD)
        self._writer.start(profile="ros2", library="trueup")
        schema = self._writer.register_schema(
            "sensor_msgs/msg/JointState", "ros2msg", ROS2_DEFINITION.encode()
        )
        self._topics = {
            name: (self._writer.register_channel(name, "cdr", schema), _Template(channels))
            for name, channels in topics.items()
        }
        self._counts = dict.fromkeys(topics, 0)

    def add(self, topic: str, columns: Columns) -> None:
        """Write rows of a topic."""
        channel, template = self._topics[topic]
        data, length = template.messages(columns), template.length
        first = self._counts[topic]
        for i, at in enumerate(columns.log_ns.tolist()):
            self._writer.add_message(
                channel,
                log_time=at,
                data=data[i * length : (i + 1) * length],
                publish_time=at,
                sequence=first + i,
            )
        self._counts[topic] = first + len(columns.log_ns)

    def finish(self, metadata: Mapping[str, Mapping[str, str]]) -> None:
        """Write records of metadata by their name, and the end of the file."""
        for name, values in metadata.items():
            self._writer.add_metadata(name, dict(values))
        self._writer.finish()  # type: ignore[no-untyped-call]


class _Template:
    """A message of a topic, into which numbers are filled."""

    def __init__(self, channels: Sequence[Channel]) -> None:
        rows = FieldColumns(channels)
        message = encode_cdr(0, rows.joints, rows.fields(np.zeros(len(channels))))
        self._bytes, self.length = np.frombuffer(message, np.uint8), len(message)
        shape = cdr_shape(message)
        places = [shape.place(c.field, c.joint or UNNAMED) for c in channels]
        self._at = [at for at in places if at is not None]

    def messages(self, columns: Columns) -> bytes:
        """The messages of some rows, one behind the other."""
        rows = np.tile(self._bytes, (len(columns.log_ns), 1))
        seconds, nanos = np.divmod(columns.stamp_ns, NS_PER_S)
        _fill(rows, STAMP_AT, seconds.astype("<i4"))
        _fill(rows, STAMP_AT + 4, nanos.astype("<u4"))
        for at, values in zip(self._at, columns.values.T, strict=True):
            _fill(rows, at, np.ascontiguousarray(values, "<f8"))
        return rows.tobytes()


def _fill(rows: NDArray[np.uint8], at: int, values: NDArray[np.generic]) -> None:
    size = values.dtype.itemsize
    rows[:, at : at + size] = values.view(np.uint8).reshape(len(values), size)
