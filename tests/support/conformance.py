"""The 416 variants of the MCAP conformance suite, written from the format's specification.

A variant is a content (nothing, a message, ten, an attachment, a metadata record) and a set of
features: ch chunks, mx message index, st statistics, rsh and rch repeated schemas and channels, ax
and mdx attachment and metadata index, chx chunk index, sum summary offsets, pad bytes behind a
record's known fields. Tests compare these bytes with 72 files of the suite, and with published
SHA-256 of others. Source: MCAP specification, "Records"; foxglove/mcap, tests/conformance
(names and contents of the variants).
"""

from __future__ import annotations

import itertools
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass

MAGIC = b"\x89MCAP0\r\n"
PAD = b"\x01\xff\xff"
EXAMPLE, SCHEMALESS = (1, "example", "a", 1, {"foo": "bar"}), (1, "example", "text", 0, {})
TIMES = (0, 2, 1, 3, 3, 5, 4, 7, 8, 9)
IN_CHUNKS, OF_MESSAGES = ("chx", "mx"), ("pad", "rch", "rsh", "st")
# features that put something into the summary section
SUMMARY = {"chx", "rch", "rsh", "st", "ax", "mdx"}


@dataclass(frozen=True)
class Variant:
    """A file, and what a reader must return from it: messages as channel, log time and data."""

    name: str
    data: bytes
    messages: list[tuple[int, int, bytes]]
    channels: dict[int, str]
    attachments: int
    metadata: dict[str, dict[str, str]]


def variants() -> Iterator[Variant]:
    """Yields every variant."""
    for name, messages, features in (
        ("NoData", 0, ("pad", "st")),
        ("OneMessage", 1, OF_MESSAGES),
        ("OneSchemalessMessage", 1, ("pad", "rch", "st")),
        ("TenMessages", 10, OF_MESSAGES),
        ("OneAttachment", 0, ("ax", "pad", "st")),
        ("OneMetadata", 0, ("mdx", "pad", "st")),
    ):
        for chosen in _subsets(features):
            yield from _summed(name, messages, chosen)
            for more in _subsets(IN_CHUNKS) if messages else ():
                yield from _summed(name, messages, {"ch"} | chosen | more)


def _subsets(features: tuple[str, ...]) -> list[set[str]]:
    return [
        set(subset)
        for size in range(len(features) + 1)
        for subset in itertools.combinations(features, size)
    ]


def _summed(name: str, messages: int, features: set[str]) -> Iterator[Variant]:
    yield _variant(name, messages, features)
    if features & SUMMARY:
        yield _variant(name, messages, features | {"sum"})


def _text(value: str) -> bytes:
    return struct.pack("<I", len(value)) + value.encode()


def _map(values: dict[str, str]) -> bytes:
    inside = b"".join(_text(key) + _text(value) for key, value in values.items())
    return struct.pack("<I", len(inside)) + inside


def _record(op: int, body: bytes, pad: bytes = b"") -> bytes:
    return struct.pack("<BQ", op, len(body) + len(pad)) + body + pad


def _variant(name: str, count: int, features: set[str]) -> Variant:
    pad = PAD if "pad" in features else b""
    channel = SCHEMALESS if name == "OneSchemalessMessage" else EXAMPLE
    out = MAGIC + _record(1, _text("") + _text(""), pad)
    schema, described, messages, index = b"", b"", [], b""
    written: list[tuple[int, bytes]] = []
    if count:
        number, topic, encoding, schema_id, values = channel
        schema = (
            struct.pack("<H", 1) + _text("Example") + _text("c") + struct.pack("<I", 3) + b"\4\5\6"
            if schema_id
            else b""
        )
        described = (
            struct.pack("<HH", number, schema_id) + _text(topic) + _text(encoding) + _map(values)
        )
        times = TIMES if count > 1 else (2,)
        sequences = range(count) if count > 1 else (10,)
        published = TIMES if count > 1 else (1,)
        for sequence, log, at in zip(sequences, times, published, strict=True):
            written.append(
                (log, _record(5, struct.pack("<HIQQ", number, sequence, log, at) + b"\1\2\3"))
            )
            messages.append((number, log, b"\1\2\3"))
    body, offsets, head = b"", [], pad if "ch" not in features else b""
    body += _record(3, schema, head) if schema else b""
    body += _record(4, described, head) if described else b""
    for log, message in written:
        offsets.append((log, len(body)))
        body += message
    first, last = (min(t for t, _ in written), max(t for t, _ in written)) if written else (0, 0)
    chunk_index = b""
    if "ch" in features:
        start = len(out)
        out += _record(
            6,
            struct.pack("<QQQI", first, last, len(body), zlib.crc32(body))
            + _text("")
            + struct.pack("<Q", len(body))
            + body,
        )
        chunk_length, indexed = len(out) - start, len(out)
        if "mx" in features:
            entries = b"".join(struct.pack("<QQ", *entry) for entry in offsets)
            index = _record(7, struct.pack("<HI", 1, len(entries)) + entries, pad)
            out += index
        where = struct.pack("<HQ", 1, indexed) if index else b""
        chunk_index = struct.pack("<QQQQI", first, last, start, chunk_length, len(where)) + where
        chunk_index += (
            struct.pack("<Q", len(index)) + _text("") + struct.pack("<QQ", len(body), len(body))
        )
    else:
        out += body
    attachment_index = metadata_index = b""
    if name == "OneAttachment":
        start, kind = len(out), "application/octet-stream"
        content = (
            struct.pack("<QQ", 2, 1)
            + _text("myFile")
            + _text(kind)
            + struct.pack("<Q", 3)
            + b"\1\2\3"
        )
        out += _record(9, content + struct.pack("<I", zlib.crc32(content)))
        attachment_index = (
            struct.pack("<QQQQQ", start, len(out) - start, 2, 1, 3) + _text("myFile") + _text(kind)
        )
    if name == "OneMetadata":
        start = len(out)
        out += _record(12, _text("myMetadata") + _map({"foo": "bar"}), pad)
        metadata_index = struct.pack("<QQ", start, len(out) - start) + _text("myMetadata")
    out += _record(15, struct.pack("<I", zlib.crc32(out)), pad)
    statistics = struct.pack(
        "<QHIIIIQQI",
        count,
        1 if schema else 0,
        1 if count else 0,
        int(name == "OneAttachment"),
        int(name == "OneMetadata"),
        int("ch" in features),
        first,
        last,
        10 if count else 0,
    )
    statistics += struct.pack("<HQ", 1, count) if count else b""
    groups = (
        (3, schema if "rsh" in features else b""),
        (4, described if "rch" in features else b""),
        (11, statistics if "st" in features else b""),
        (8, chunk_index if "chx" in features else b""),
        (10, attachment_index if "ax" in features else b""),
        (13, metadata_index if "mdx" in features else b""),
    )
    return Variant(
        "-".join(
            [
                name,
                *sorted(features - {"sum", "pad", "st"} | features & {"pad"}),
                *(f for f in ("st", "sum") if f in features),
            ]
        ),
        _with_summary(out, groups, pad, "sum" in features),
        messages,
        {1: "example"} if count else {},
        int(name == "OneAttachment"),
        {"myMetadata": {"foo": "bar"}} if name == "OneMetadata" else {},
    )


def _with_summary(
    out: bytes, groups: tuple[tuple[int, bytes], ...], pad: bytes, summed: bool
) -> bytes:
    """Returns the file with its summary section and footer."""
    start, summary, offsets = len(out), b"", b""
    for op, body in groups:
        if body:
            record = _record(op, body, pad)
            offsets += _record(14, struct.pack("<BQQ", op, start + len(summary), len(record)), pad)
            summary += record
    offset_start = start + len(summary) if summed and summary else 0
    summary += offsets if offset_start else b""
    footer = struct.pack("<BQQQ", 2, 20, start if summary else 0, offset_start)
    return out + summary + footer + struct.pack("<I", zlib.crc32(summary + footer)) + MAGIC
