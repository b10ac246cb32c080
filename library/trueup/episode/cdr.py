"""JointState in ROS 2 CDR: bytes to columns.

A recorder writes one structure thousands of times. The decoder reads one message, then takes every
other one of equal length and structure bytes as a row of a matrix; only messages that differ are
read by themselves. Source: OMG Common Data Representation (DDS-XTypes 1.3, section 7.4.3);
sensor_msgs/msg/JointState (ROS 2).
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueup.episode.container import Message, MessageBlock
from trueup.episode.joint_state import FIELDS, Columns, JointState, decode_each, joint_index
from trueup.episode.layout import Channel, Field
from trueup.errors import NotAnEpisode

ROS2_NAMES = (
    "sensor_msgs/msg/JointState",
    "sensor_msgs/JointState",
    "sensor_msgs::msg::dds_::JointState_",
)
CDR_HEAD_BYTES = 4


@dataclass(frozen=True, slots=True)
class CdrShape:
    """Where a message keeps its joint names and, for each field, its first value and how many there
    are."""

    names: tuple[str, ...]
    fields: tuple[tuple[int, int], ...]
    order: str

    def place(self, field: Field, joint: str | None) -> int | None:
        """Where the value of a joint's field stands, None where the message has none."""
        at, count = self.fields[FIELDS.index(field)]
        index = joint_index(self.names, joint)
        return at + 8 * index if index is not None and index < count else None


def cdr_shape(data: bytes) -> CdrShape:
    """Where a message keeps what it holds. Raises ValueError, struct.error."""
    if len(data) < CDR_HEAD_BYTES or data[0] != 0 or data[1] not in (0, 1):
        raise ValueError("its encapsulation is not plain CDR")
    order = "<" if data[1] else ">"
    at = 12
    _, at = _cdr_text(data, at, order)
    count, at = _cdr_count(data, at, order, 5)
    names = []
    for _ in range(count):
        name, at = _cdr_text(data, at, order)
        names.append(name)
    fields = []
    for _ in FIELDS:
        count, at = _cdr_count(data, at, order, 8)
        # eight-byte alignment counts from behind the four-byte head
        at = at + (4 - at) % 8 if count else at
        fields.append((at, count))
        at += 8 * count
        if at > len(data):
            raise ValueError("an array does not fit it")
    return CdrShape(tuple(names), tuple(fields), order)


def _cdr_count(data: bytes, at: int, order: str, least_bytes: int) -> tuple[int, int]:
    at += -at % 4
    (count,) = struct.unpack_from(order + "I", data, at)
    if count * least_bytes > len(data) + 8:
        raise ValueError(f"it declares {count} entries")
    return count, at + 4


def _cdr_text(data: bytes, at: int, order: str) -> tuple[str, int]:
    length, at = _cdr_count(data, at, order, 1)
    if at + length > len(data):
        raise ValueError("a string does not fit it")
    return data[at : at + max(length - 1, 0)].decode(), at + length


def read_cdr(data: bytes) -> JointState:
    """One message. Raises ValueError, struct.error."""
    shape = cdr_shape(data)
    seconds, nanoseconds = struct.unpack_from(shape.order + "iI", data, 4)
    values = tuple(struct.unpack_from(f"{shape.order}{n}d", data, at) for at, n in shape.fields)
    return JointState(seconds * 1_000_000_000 + nanoseconds, shape.names, values)


def message_places(
    block: MessageBlock, messages: Sequence[Message]
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Where messages begin in their block, how long they are, and their log times [ns], `(n,)`
    each. Raises NotAnEpisode where a time does not fit."""
    try:
        starts, lengths, log = np.array(messages, np.int64).reshape(-1, 3).T
    except OverflowError as error:
        raise NotAnEpisode(
            "a log time does not fit 64 bits", rule="clock", byte=block.byte
        ) from error
    return starts, lengths, log


def decode_cdr(
    block: MessageBlock, messages: list[Message], channels: Sequence[Channel]
) -> Columns:
    """Columns of CDR messages, all at once where they share one structure. Raises NotAnEpisode."""
    starts, lengths, log = message_places(block, messages)
    length = int(lengths[0])
    first = block.data[messages[0][0] : messages[0][0] + length]
    try:
        shape = cdr_shape(first)
    except (ValueError, struct.error):
        return decode_each(block, messages, channels, read_cdr)
    if (lengths != length).any():
        return decode_each(block, messages, channels, read_cdr)
    rows = np.frombuffer(block.data, np.uint8)[starts[:, None] + np.arange(length)]
    free = np.zeros(length, bool)
    free[4:12] = True
    for at, count in shape.fields:
        free[at : at + 8 * count] = True
    if (rows[:, ~free] != np.frombuffer(first, np.uint8)[~free]).any():
        return decode_each(block, messages, channels, read_cdr)
    return Columns(log, _cdr_stamps(rows, shape.order), _cdr_values(rows, shape, channels))


def _cdr_stamps(rows: NDArray[np.uint8], order: str) -> NDArray[np.int64]:
    seconds = np.ascontiguousarray(rows[:, 4:8]).view(order + "i4")[:, 0].astype(np.int64)
    nanoseconds = np.ascontiguousarray(rows[:, 8:12]).view(order + "u4")[:, 0].astype(np.int64)
    return seconds * 1_000_000_000 + nanoseconds


def _cdr_values(
    rows: NDArray[np.uint8], shape: CdrShape, channels: Sequence[Channel]
) -> NDArray[np.float64]:
    values = np.full((len(rows), len(channels)), np.nan)
    for column, channel in enumerate(channels):
        begin = shape.place(channel.field, channel.joint)
        if begin is not None:
            values[:, column] = np.ascontiguousarray(rows[:, begin : begin + 8]).view(
                shape.order + "f8"
            )[:, 0]
    return values
