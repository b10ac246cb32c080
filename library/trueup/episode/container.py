"""The parts of an MCAP file, and the limits on one file.

Source: MCAP format specification, https://mcap.dev/spec (2026).
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from enum import IntEnum

MAGIC = b"\x89MCAP0\r\n"
RECORD_HEAD = struct.Struct("<BQ")
MESSAGE_HEAD = struct.Struct("<HIQQ")


class Op(IntEnum):
    """Record kinds of MCAP."""

    HEADER = 0x01
    FOOTER = 0x02
    SCHEMA = 0x03
    CHANNEL = 0x04
    MESSAGE = 0x05
    CHUNK = 0x06
    MESSAGE_INDEX = 0x07
    CHUNK_INDEX = 0x08
    ATTACHMENT = 0x09
    ATTACHMENT_INDEX = 0x0A
    STATISTICS = 0x0B
    METADATA = 0x0C
    METADATA_INDEX = 0x0D
    SUMMARY_OFFSET = 0x0E
    DATA_END = 0x0F


NAMES = {int(op): op.name.title().replace("_", "") for op in Op}
IN_SUMMARY = {
    Op.SCHEMA,
    Op.CHANNEL,
    Op.CHUNK_INDEX,
    Op.ATTACHMENT_INDEX,
    Op.STATISTICS,
    Op.METADATA_INDEX,
    Op.SUMMARY_OFFSET,
    Op.FOOTER,
}
NOT_IN_DATA = {
    Op.HEADER,
    Op.FOOTER,
    Op.CHUNK_INDEX,
    Op.ATTACHMENT_INDEX,
    Op.STATISTICS,
    Op.METADATA_INDEX,
    Op.SUMMARY_OFFSET,
}


@dataclass(frozen=True, slots=True)
class Limits:
    """Limits on one file, in bytes or as counts. All chunks together may unfold to `unfold_ratio`
    times the file read so far, or to `unfold_free_bytes` if that is more."""

    file_bytes: int = 2 << 30
    record_bytes: int = 64 << 20
    chunk_bytes: int = 64 << 20
    unfold_ratio: float = 100.0
    unfold_free_bytes: int = 4 << 20  # so much is harmless, however well it compresses
    records: int = 50_000_000
    channels: int = 4096
    definition_bytes: int = 16 << 20


LIMITS = Limits()


@dataclass(frozen=True, slots=True)
class Schema:
    """How the messages of a channel are described."""

    id: int
    name: str
    encoding: str
    data: bytes


@dataclass(frozen=True, slots=True)
class Topic:
    """A channel of the file: a topic with one encoding."""

    id: int
    schema: Schema | None
    name: str
    encoding: str
    metadata: dict[str, str]


@dataclass(frozen=True, slots=True)
class Metadata:
    """A named record of string values."""

    name: str
    values: dict[str, str]


# Where a message's data begin in the block, how long they are, and its log time [ns].
Message = tuple[int, int, int]


@dataclass(slots=True)
class MessageBlock:
    """Messages in one buffer, by channel; `byte` is where the buffer's record is in the file."""

    data: bytes
    byte: int
    messages: dict[int, list[Message]] = field(default_factory=dict)


class Loose:
    """Messages outside chunks, gathered into a block."""

    def __init__(self) -> None:
        self._data = bytearray()
        self._byte = 0
        self._messages: dict[int, list[Message]] = {}
        self.size = 0

    def add(self, channel: int, data: bytes, log_time_ns: int, byte: int) -> None:
        """Add a message, whose record is at `byte` of the file."""
        self._byte = self._byte or byte
        self._messages.setdefault(channel, []).append((len(self._data), len(data), log_time_ns))
        self._data += data
        self.size += MESSAGE_HEAD.size + len(data)

    def block(self) -> MessageBlock:
        """The messages gathered so far."""
        return MessageBlock(bytes(self._data), self._byte, self._messages)


@dataclass(slots=True)
class Contents:
    """What the walk has read so far."""

    topics: dict[int, Topic] = field(default_factory=dict)
    schemas: dict[int, Schema] = field(default_factory=dict)
    metadata: list[Metadata] = field(default_factory=list)
    metadata_records: int = 0
    messages: int = 0
    chunks: int = 0
    attachments: int = 0
    records: int = 0


def name_of(op: int) -> str:
    """A record kind in words."""
    return NAMES.get(op, f"record kind {op:#04x}")
