"""Write an episode as MCAP, as a robot would have recorded it."""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping, Sequence
from enum import StrEnum
from typing import BinaryIO

import numpy as np
import orjson
from mcap.writer import CompressionType, Writer
from numpy.typing import NDArray

from trueup.episode.joint_state import FIELDS
from trueup.episode.layout import Channel, Layout
from trueup.episode.role import Role

ROS2_DEFINITION = """std_msgs/Header header
string[] name
float64[] position
float64[] velocity
float64[] effort
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""


UNNAMED = "joint"  # what a joint is called that its plant gives no name


class Encoding(StrEnum):
    """How messages are written."""

    CDR = "cdr"
    JSON = "json"
    PROTOBUF = "protobuf"


Values = Mapping[str, Sequence[float]]
Encode = Callable[[int, Sequence[str], Values], bytes]


def write_episode(
    stream: BinaryIO,
    *,
    stamps_ns: NDArray[np.int64],
    observations: NDArray[np.float64],
    commands: NDArray[np.float64],
    layout: Layout,
    role: Role | None,
    conditions: Mapping[str, str],
    encoding: Encoding = Encoding.CDR,
    compression: CompressionType = CompressionType.ZSTD,
    applied: NDArray[np.float64] | None = None,
    effort: NDArray[np.float64] | None = None,
) -> None:
    """Write `(samples, channels)` observations and as many commands, or one less, as JointState on
    the layout's topics; and, where they are known, what was `applied` of them, and the `effort`
    `(samples, command channels)` that was measured with the observations.

    Without a role the file is a plan: commands alone, and no episode.
    """
    writer = Writer(stream, compression=compression)
    writer.start(profile="ros2" if encoding is Encoding.CDR else "", library="trueup")
    name, schema_encoding, definition, encode = _FORMATS[encoding]()
    schema = writer.register_schema(name, schema_encoding, definition)
    orders, shown = FieldColumns(layout.commands), layout.observations
    if effort is not None:
        shown, observations = shown + layout.efforts, np.hstack([observations, effort])
    states = FieldColumns(shown)
    written = [
        (layout.observation_topic, states, observations),
        (layout.command_topic, orders, commands),
        *([] if applied is None else [(layout.applied_topic, orders, applied)]),
    ]
    topics = [
        (writer.register_channel(topic, encoding, schema), rows, values)
        for topic, rows, values in written
    ]
    for i, stamp in enumerate(stamps_ns.tolist()):
        for channel, rows, values in topics:
            if i < len(values):
                data = encode(stamp, rows.joints, rows.fields(values[i]))
                writer.add_message(
                    channel, log_time=stamp, data=data, publish_time=stamp, sequence=i
                )
    writer.add_metadata(
        *(
            ("plan", dict(conditions))
            if role is None
            else ("episode", {"role": str(role), **conditions})
        )
    )
    writer.finish()  # type: ignore[no-untyped-call]


class FieldColumns:
    """For each value of a JointState, the column of a sample that holds it."""

    def __init__(self, channels: Sequence[Channel]) -> None:
        self.joints = list(dict.fromkeys(c.joint or UNNAMED for c in channels))
        self._columns = {
            f: [
                (self.joints.index(c.joint or UNNAMED), i)
                for i, c in enumerate(channels)
                if c.field is f
            ]
            for f in FIELDS
        }

    def fields(self, sample: NDArray[np.float64]) -> Values:
        """A sample's values by the message's field; nan where a joint has no channel of the
        field."""
        return {f.value: self._fill(sample, pairs) for f, pairs in self._columns.items()}

    def _fill(self, sample: NDArray[np.float64], pairs: Sequence[tuple[int, int]]) -> list[float]:
        values = [float("nan")] * len(self.joints) if pairs else []
        for joint, column in pairs:
            values[joint] = float(sample[column])
        return values


def _cdr() -> tuple[str, str, bytes, Encode]:
    return "sensor_msgs/msg/JointState", "ros2msg", ROS2_DEFINITION.encode(), encode_cdr


def encode_cdr(stamp_ns: int, names: Sequence[str], values: Values) -> bytes:
    """A JointState in ROS 2 CDR."""
    body = bytearray(
        struct.pack("<iIIB", stamp_ns // 1_000_000_000, stamp_ns % 1_000_000_000, 1, 0)
    )
    _count(body, len(names))
    for name in names:
        text = name.encode() + b"\0"
        _count(body, len(text))
        body += text
    for field in FIELDS:
        numbers = values.get(field.value, ())
        _count(body, len(numbers))
        if numbers:
            body += bytes(-len(body) % 8) + struct.pack(f"<{len(numbers)}d", *numbers)
    return b"\0\1\0\0" + bytes(body)


def _count(body: bytearray, count: int) -> None:
    body += bytes(-len(body) % 4) + struct.pack("<I", count)


def _json() -> tuple[str, str, bytes, Encode]:
    numbers = {"type": "array", "items": {"type": ["number", "null"]}}
    schema = {
        "type": "object",
        "properties": {
            "header": {"type": "object"},
            "name": {"type": "array", "items": {"type": "string"}},
            **{f.value: numbers for f in FIELDS},
        },
    }
    return "sensor_msgs.JointState", "jsonschema", orjson.dumps(schema), _encode_json


def _encode_json(stamp_ns: int, names: Sequence[str], values: Values) -> bytes:
    stamp = {"sec": stamp_ns // 1_000_000_000, "nanosec": stamp_ns % 1_000_000_000}
    return orjson.dumps({"header": {"stamp": stamp, "frame_id": ""}, "name": list(names), **values})


def _protobuf() -> tuple[str, str, bytes, Encode]:
    from google.protobuf import descriptor_pb2, descriptor_pool, message_factory  # noqa: PLC0415  (loads slowly, few logs need it)

    file = descriptor_pb2.FileDescriptorProto(
        name="sensor_msgs/JointState.proto", package="sensor_msgs", syntax="proto3"
    )
    f = descriptor_pb2.FieldDescriptorProto
    for name, fields in (
        ("Time", [("sec", f.TYPE_INT32, 1), ("nanosec", f.TYPE_UINT32, 1)]),
        ("Header", [("stamp", ".sensor_msgs.Time", 1), ("frame_id", f.TYPE_STRING, 1)]),
        (
            "JointState",
            [
                ("header", ".sensor_msgs.Header", 1),
                ("name", f.TYPE_STRING, 3),
                *((str(x), f.TYPE_DOUBLE, 3) for x in FIELDS),
            ],
        ),
    ):
        kind = file.message_type.add(name=name)
        for number, (field, what, label) in enumerate(fields, 1):
            typed = (
                {"type": f.TYPE_MESSAGE, "type_name": what}
                if isinstance(what, str)
                else {"type": what}
            )
            kind.field.add(name=field, number=number, label=label, **typed)
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    message = message_factory.GetMessageClass(pool.FindMessageTypeByName("sensor_msgs.JointState"))

    def encode(stamp_ns: int, names: Sequence[str], values: Values) -> bytes:
        stamp = {"sec": stamp_ns // 1_000_000_000, "nanosec": stamp_ns % 1_000_000_000}
        return bytes(message(header={"stamp": stamp}, name=names, **values).SerializeToString())

    return (
        "sensor_msgs.JointState",
        "protobuf",
        descriptor_pb2.FileDescriptorSet(file=[file]).SerializeToString(),
        encode,
    )


_FORMATS: dict[Encoding, Callable[[], tuple[str, str, bytes, Encode]]] = {
    Encoding.CDR: _cdr,
    Encoding.JSON: _json,
    Encoding.PROTOBUF: _protobuf,
}
