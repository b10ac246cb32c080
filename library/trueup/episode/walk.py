"""A bounded walk over an MCAP file that trusts nothing it reads.

Rules, each named in the error that it raises together with the byte at which it is broken:
- magic: the file begins and ends with the eight magic bytes, and nothing follows them;
- order: a Header comes first, one DataEnd closes the data, only index records and one Footer follow
  it;
- length: no record and no field is longer than what is left, nor than the declared limits;
- known: a message names a known channel, a channel a known schema, and neither is ever redefined;
- chunk: a chunk holds schemas, channels and messages only, of exactly the declared size once
  decompressed;
- ratio: all chunks together do not unfold to more than a declared multiple of the file read so far;
- crc: every checksum that the file carries holds;
- index: every offset of an index lies inside the file, and the statistics agree with what was
  counted;
- count: records, channels and the bytes of their definitions stay within the declared limits.

Unknown records and bytes behind a record's known fields are skipped, as the format demands.
Source: MCAP format specification, https://mcap.dev/spec (2026).
"""

from __future__ import annotations

import zlib
from collections.abc import Collection, Iterator
from typing import BinaryIO

from trueup.episode.compression import decompress
from trueup.episode.container import (
    IN_SUMMARY,
    LIMITS,
    MAGIC,
    MESSAGE_HEAD,
    NAMES,
    NOT_IN_DATA,
    RECORD_HEAD,
    Contents,
    Limits,
    Loose,
    MessageBlock,
    Op,
    name_of,
)
from trueup.episode.fields import Fields
from trueup.episode.records import RecordReader
from trueup.errors import MalformedMcap, TooLarge

NO_MCAP = (
    "This is not an MCAP file. For a recording of another format, give its role as well: "
    "docs/recordings.md."
)
# Messages outside chunks are handed on together, once they are this many bytes.
GATHER_BYTES = 1 << 20


class Walk:
    """One pass over a stream of `size` bytes; iterate it to its end, or the file has not been
    checked.

    Yields a MessageBlock for each chunk and for messages outside chunks; `contents` grows as it
    goes, and of the metadata keeps the records named in `wanted`. Raises MalformedMcap (facts
    `rule`, `byte`) and TooLarge (facts `limit`, `byte`).
    """

    def __init__(
        self, stream: BinaryIO, size: int, limits: Limits = LIMITS, wanted: Collection[str] = ()
    ) -> None:
        self.contents = Contents()
        self._records = RecordReader(self.contents, limits, wanted)
        self._stream, self._size, self._limits = stream, size, limits
        self._at = 0
        self._crc = 0
        self._unfolded = 0

    def __iter__(self) -> Iterator[MessageBlock]:
        if self._size > self._limits.file_bytes:
            raise TooLarge(
                f"the file has {self._size} bytes, {self._limits.file_bytes} are allowed",
                limit="file_bytes",
                byte=0,
            )
        self._magic()
        self._header()
        yield from self._data()
        self._summary()

    # -- the sections of the file

    def _magic(self) -> None:
        at = self._at
        if self._take(len(MAGIC)) != MAGIC:
            raise MalformedMcap(
                "the MCAP magic is missing",
                rule="magic",
                byte=at,
                hint=NO_MCAP if at == 0 else None,
            )

    def _header(self) -> None:
        at, op, body = self._record()
        if op != Op.HEADER:
            raise MalformedMcap(
                f"the first record is {name_of(op)}, not Header", rule="order", byte=at
            )
        fields = Fields(body, at)
        fields.text(), fields.text()

    def _data(self) -> Iterator[MessageBlock]:
        loose = Loose()
        while True:
            crc_before = self._crc
            at, op, body = self._record()
            if op == Op.MESSAGE:
                self._message(loose, body, at)
            if loose.size >= (GATHER_BYTES if op == Op.MESSAGE else 1):
                yield loose.block()
                loose = Loose()
            if op == Op.DATA_END:
                return self._data_end(at, body, crc_before)
            if op in NOT_IN_DATA:
                raise MalformedMcap(
                    f"{name_of(op)} stands in the data section", rule="order", byte=at
                )
            if op == Op.CHUNK:
                yield self._chunk(at, body)
            elif op != Op.MESSAGE:
                self._records.read(at, op, body)

    def _data_end(self, at: int, body: bytes, crc: int) -> None:
        declared = Fields(body, at).uint(4)
        if declared and declared != crc:
            raise MalformedMcap(
                "the checksum of the data section does not hold", rule="crc", byte=at
            )

    def _summary(self) -> None:
        start = self._at
        self._crc = 0
        while True:
            crc_before = self._crc
            at, op, body = self._record()
            if op in NAMES and op not in IN_SUMMARY:
                raise MalformedMcap(
                    f"{name_of(op)} stands behind the data section", rule="order", byte=at
                )
            if op == Op.FOOTER:
                self._footer(at, body, start, crc_before)
                break
            self._index(at, op, body)
        self._magic()
        if self._at != self._size or self._stream.read(1):
            raise MalformedMcap("bytes follow the closing magic", rule="magic", byte=self._at)

    def _footer(self, at: int, body: bytes, start: int, crc: int) -> None:
        fields = Fields(body, at)
        summary, offsets, declared = fields.uint(8), fields.uint(8), fields.uint(4)
        if summary not in (0, start) or (summary == 0 and at != start):
            raise MalformedMcap(
                f"the footer puts the summary at byte {summary}, it begins at {start}",
                rule="index",
                byte=at,
            )
        if offsets and not start <= offsets <= at:
            raise MalformedMcap(
                "the footer's summary offsets lie outside the summary", rule="index", byte=at
            )
        if declared and declared != zlib.crc32(
            RECORD_HEAD.pack(Op.FOOTER, len(body)) + body[:16], crc
        ):
            raise MalformedMcap("the checksum of the summary does not hold", rule="crc", byte=at)

    # -- single records

    def _index(self, at: int, op: int, body: bytes) -> None:
        fields = Fields(body, at)
        if op == Op.SCHEMA:
            self._records.schema(at, body)
        elif op == Op.CHANNEL:
            self._records.channel(at, body)
        elif op == Op.STATISTICS:
            self._records.statistics(at, fields)
        elif op == Op.CHUNK_INDEX:
            fields.uint(8), fields.uint(8)
            self._inside(at, fields.uint(8), fields.uint(8))
        elif op in (Op.ATTACHMENT_INDEX, Op.METADATA_INDEX):
            self._inside(at, fields.uint(8), fields.uint(8))
        elif op == Op.SUMMARY_OFFSET:
            fields.uint(1)
            self._inside(at, fields.uint(8), fields.uint(8))

    def _inside(self, at: int, start: int, length: int) -> None:
        if start < len(MAGIC) or start + length > self._size - len(MAGIC):
            raise MalformedMcap(
                f"an index points to bytes {start} to {start + length}, outside the file",
                rule="index",
                byte=at,
            )

    def _message(self, loose: Loose, body: bytes, at: int) -> None:
        if len(body) < MESSAGE_HEAD.size:
            raise MalformedMcap("a message is shorter than its own header", rule="length", byte=at)
        channel, _, log_time_ns, _ = MESSAGE_HEAD.unpack_from(body)
        if channel not in self.contents.topics:
            raise MalformedMcap(
                f"a message names channel {channel}, which is not known yet", rule="known", byte=at
            )
        self.contents.messages += 1
        loose.add(channel, body[MESSAGE_HEAD.size :], log_time_ns, at)

    def _chunk(self, at: int, body: bytes) -> MessageBlock:
        self.contents.chunks += 1
        fields = Fields(body, at)
        fields.uint(8), fields.uint(8)
        size, crc, compression = fields.uint(8), fields.uint(4), fields.text()
        stored = fields.long_block()
        self._allow_chunk(at, size)
        data = decompress(compression, stored, size, at)
        if crc and crc != zlib.crc32(data):
            raise MalformedMcap("the checksum of a chunk does not hold", rule="crc", byte=at)
        block = MessageBlock(data, at)
        self._unfold(block)
        return block

    def _allow_chunk(self, at: int, size: int) -> None:
        limits = self._limits
        self._unfolded += size
        if size > limits.chunk_bytes:
            raise TooLarge(
                f"a chunk declares {size} bytes, {limits.chunk_bytes} are allowed",
                limit="chunk_bytes",
                byte=at,
            )
        if self._unfolded > max(limits.unfold_free_bytes, limits.unfold_ratio * self._at):
            raise TooLarge(
                f"the first {self._at} bytes of the file unfold to {self._unfolded}",
                limit="unfold_ratio",
                byte=at,
            )

    def _unfold(self, block: MessageBlock) -> None:
        """Sort the chunk's records. This is the hot loop of the walk, so it is flat, and its names
        are bound once."""
        data, end, at, count = block.data, len(block.data), 0, 0
        head, message_head = RECORD_HEAD.unpack_from, MESSAGE_HEAD.unpack_from
        topics, messages = self.contents.topics, block.messages
        message_count, shortest = 0, MESSAGE_HEAD.size
        head_bytes, is_message = RECORD_HEAD.size, int(Op.MESSAGE)
        while at < end:
            if end - at < head_bytes:
                raise MalformedMcap(
                    "a chunk ends inside a record's head",
                    rule="length",
                    byte=block.byte,
                    chunk_byte=at,
                )
            op, length = head(data, at)
            start = at + head_bytes
            if length > end - start:
                raise MalformedMcap(
                    "a record is longer than its chunk",
                    rule="length",
                    byte=block.byte,
                    chunk_byte=at,
                )
            count += 1
            if op == is_message:
                if length < shortest:
                    raise MalformedMcap(
                        "a message is shorter than its own header",
                        rule="length",
                        byte=block.byte,
                        chunk_byte=at,
                    )
                channel, _, log_time_ns, _ = message_head(data, start)
                if channel not in messages:
                    if channel not in topics:
                        raise MalformedMcap(
                            f"a message names channel {channel}, which is not known yet",
                            rule="known",
                            byte=block.byte,
                            chunk_byte=at,
                        )
                    messages[channel] = []
                messages[channel].append((start + shortest, length - shortest, log_time_ns))
                message_count += 1
            elif op in (Op.SCHEMA, Op.CHANNEL):
                self._records.read(block.byte, op, data[start : start + length])
            elif op == 0 or op in NAMES:
                raise MalformedMcap(
                    f"{name_of(op)} stands in a chunk", rule="chunk", byte=block.byte, chunk_byte=at
                )
            at = start + length
        self.contents.messages += message_count
        self._records.count(count, block.byte)

    # -- bytes

    def _record(self) -> tuple[int, int, bytes]:
        at = self._at
        op, length = RECORD_HEAD.unpack(self._take(RECORD_HEAD.size))
        if op == 0:
            raise MalformedMcap("the record kind 0 is not allowed", rule="order", byte=at)
        if length > self._size - self._at:
            raise MalformedMcap(
                f"a record declares {length} bytes, {self._size - self._at} are left",
                rule="length",
                byte=at,
            )
        if length > self._limits.record_bytes:
            raise TooLarge(
                f"a record declares {length} bytes, {self._limits.record_bytes} are allowed",
                limit="record_bytes",
                byte=at,
            )
        self._records.count(1, at)
        return at, op, self._take(length)

    def _take(self, length: int) -> bytes:
        data = self._stream.read(length)
        if len(data) < length:
            raise MalformedMcap(
                f"the file ends {length - len(data)} bytes too early",
                rule="length",
                byte=self._at + len(data),
            )
        self._at += length
        self._crc = zlib.crc32(data, self._crc)
        return data
