"""The bounded walk: what it reads, and each rule with a file that breaks it."""

import contextlib
import hashlib
import io
import json
import struct
import zlib
from pathlib import Path

import lz4.frame
import pytest
import zstandard
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.writer import CompressionType, Writer

from tests.support.conformance import variants
from trueup.episode.container import LIMITS, MAGIC, Limits, Op
from trueup.episode.walk import Walk
from trueup.errors import BadEpisode, MalformedMcap, TooLarge

PUBLISHED = {  # SHA-256 of files of the suite that are not at hand
    "OneSchemalessMessage-ch-pad-rch": (
        "4047f3cadb4db6e3a5667c3086de582f691b7fa51d7c0b62f68c8bbf08656a46"
    ),
    "TenMessages": "f0ac493fe49dd128fe676619e4198a326dde12d60cac8a27e8a4fb2a61a630c7",
    "TenMessages-ch-chx-mx-pad-rch-rsh-st-sum": (
        "54f3c5a0ca350cd4cf6326992926f491178a46aa694686e3781aa19c4255fc88"
    ),
}
CONFORMANCE = sorted((Path(__file__).parents[2] / "golden" / "mcap-conformance").glob("*.mcap"))


def walk(data: bytes, limits: Limits = LIMITS) -> Walk:
    file_walk = Walk(io.BytesIO(data), len(data), limits, wanted=("m",))
    for _ in file_walk:
        pass
    return file_walk


def record(op: int, body: bytes) -> bytes:
    return struct.pack("<BQ", op, len(body)) + body


def text(value: str) -> bytes:
    return struct.pack("<I", len(value)) + value.encode()


def file(
    *data: bytes, summary: bytes = b"", footer: bytes | None = None, data_crc: int = 0
) -> bytes:
    """A sound file around the given data records."""
    head = (
        MAGIC
        + record(Op.HEADER, text("") + text(""))
        + b"".join(data)
        + record(Op.DATA_END, struct.pack("<I", data_crc))
    )
    start = len(head) if summary else 0
    return head + summary + (footer or record(Op.FOOTER, struct.pack("<QQI", start, 0, 0))) + MAGIC


SCHEMA = record(Op.SCHEMA, struct.pack("<H", 1) + text("s") + text("") + text(""))
CHANNEL = record(Op.CHANNEL, struct.pack("<HH", 1, 1) + text("/t") + text("cdr") + text(""))
MESSAGE = record(Op.MESSAGE, struct.pack("<HIQQ", 1, 0, 5, 5) + b"data")


def chunk(
    inner: bytes,
    *,
    compression: str = "",
    size: int | None = None,
    crc: int = 0,
    stored: bytes | None = None,
) -> bytes:
    kept = stored if stored is not None else inner
    head = struct.pack("<QQQI", 0, 0, len(inner) if size is None else size, crc) + text(compression)
    return record(Op.CHUNK, head + struct.pack("<Q", len(kept)) + kept)


def statistics(messages: int, chunks: int = 0) -> bytes:
    return record(Op.STATISTICS, struct.pack("<QHIIIIQQI", messages, 1, 1, 0, 0, chunks, 0, 0, 0))


@pytest.mark.parametrize("path", CONFORMANCE, ids=lambda p: p.stem)
def test_a_conformance_file_reads_as_published(path):
    published = json.loads(path.with_suffix(".json").read_text())["records"]
    names = [
        value
        for r in published
        if r["type"] == "Metadata"
        for key, value in r["fields"]
        if key == "name"
    ]
    file_walk = Walk(io.BytesIO(path.read_bytes()), path.stat().st_size, wanted=names)
    messages = [
        (channel, log_ns, block.data[start : start + length])
        for block in file_walk
        for channel, entries in block.messages.items()
        for start, length, log_ns in entries
    ]
    fields = [(r["type"], dict(r["fields"])) for r in published]
    assert messages == [
        (int(f["channel_id"]), int(f["log_time"]), bytes(map(int, f["data"])))
        for kind, f in fields
        if kind == "Message"
    ]
    assert {t.id: t.name for t in file_walk.contents.topics.values()} == {
        int(f["id"]): f["topic"] for kind, f in fields if kind == "Channel"
    }
    assert {s.id: (s.name, s.encoding, s.data) for s in file_walk.contents.schemas.values()} == {
        int(f["id"]): (f["name"], f["encoding"], bytes(map(int, f["data"])))
        for kind, f in fields
        if kind == "Schema"
    }
    assert [(m.name, m.values) for m in file_walk.contents.metadata] == [
        (f["name"], f["metadata"]) for kind, f in fields if kind == "Metadata"
    ]
    assert file_walk.contents.attachments == sum(kind == "Attachment" for kind, _ in fields)


def test_there_are_72_conformance_files_and_we_write_them_and_the_other_344_alike():
    written = {v.name: v.data for v in variants()}
    assert (len(CONFORMANCE), len(written)) == (72, 416)
    assert all(written[path.stem] == path.read_bytes() for path in CONFORMANCE)
    for name, digest in PUBLISHED.items():
        assert hashlib.sha256(written[name]).hexdigest() == digest


def test_all_416_variants_of_the_conformance_suite_are_read():
    for variant in variants():
        file_walk = Walk(
            io.BytesIO(variant.data), len(variant.data), wanted=tuple(variant.metadata)
        )
        messages = [
            (channel, log_ns, block.data[start : start + length])
            for block in file_walk
            for channel, entries in block.messages.items()
            for start, length, log_ns in entries
        ]
        assert messages == variant.messages, variant.name
        assert {t.id: t.name for t in file_walk.contents.topics.values()} == variant.channels, (
            variant.name
        )
        assert {m.name: m.values for m in file_walk.contents.metadata} == variant.metadata, (
            variant.name
        )
        assert file_walk.contents.attachments == variant.attachments, variant.name


def pad(data: bytes) -> bytes:
    """The same file with bytes behind the known fields of every record that may have them, as the
    `pad` variants have."""
    at, out = len(MAGIC), MAGIC
    while data[at : at + len(MAGIC)] != MAGIC:
        op, length = struct.unpack_from("<BQ", data, at)
        body = data[at + 9 : at + 9 + length]
        more = b"" if op in (Op.MESSAGE, Op.CHUNK, Op.ATTACHMENT) else b"\1\2\3"
        # their checksums are of the file as it was
        body = {Op.FOOTER: bytes(20), Op.DATA_END: bytes(4)}.get(op, body)
        out += record(op, body + more)
        at += 9 + length
    return out + MAGIC


@pytest.mark.parametrize(
    "path", [p for p in CONFORMANCE if "-" not in p.stem], ids=lambda p: p.stem
)
def test_bytes_behind_known_fields_are_skipped(path):
    data = path.read_bytes()
    assert walk(pad(data)).contents.messages == walk(data).contents.messages


@pytest.mark.parametrize("compression", list(CompressionType))
def test_what_the_stock_writer_writes_is_read(compression):
    stream = io.BytesIO()
    writer = Writer(stream, compression=compression, chunk_size=2000)
    writer.start()
    schema = writer.register_schema("s", "", b"")
    channel = writer.register_channel("/t", "json", schema)
    for i in range(300):
        writer.add_message(channel, log_time=i, data=b"x" * (i % 50), publish_time=i)
    writer.add_attachment(0, 0, "a", "text/plain", b"hello")
    writer.finish()
    file_walk = walk(stream.getvalue())
    assert (file_walk.contents.messages, file_walk.contents.attachments) == (300, 1)


SOUND = file(SCHEMA, CHANNEL, MESSAGE, summary=statistics(1))
UNKNOWN_MESSAGE = record(Op.MESSAGE, struct.pack("<HIQQ", 9, 0, 5, 5))
INNER = SCHEMA + CHANNEL + MESSAGE
EMPTY = (b"\x80" + bytes(8)) * 100_000
BOMB = zstandard.ZstdCompressor().compress(bytes(40 << 20))

BROKEN = {
    "no magic": (b"MCAP" + SOUND, "magic"),
    "empty": (b"", "length"),
    "no closing magic": (SOUND[:-8] + b"????????", "magic"),
    "bytes behind the end": (SOUND + b"x", "magic"),
    "cut in the middle": (SOUND[: len(SOUND) // 2], "length"),
    "cut by one": (SOUND[:-1], "length"),
    "no header": (MAGIC + SOUND[len(MAGIC) + 17 :], "order"),
    "two headers": (file(record(Op.HEADER, text("") + text(""))), "order"),
    "record kind 0": (file(record(0, b"")), "order"),
    "footer in the data": (file(record(Op.FOOTER, bytes(20))), "order"),
    "message behind the data": (file(SCHEMA, CHANNEL, summary=MESSAGE), "order"),
    "length beyond the file": (file(struct.pack("<BQ", Op.MESSAGE, 1 << 62)), "length"),
    "text beyond its record": (file(record(Op.METADATA, struct.pack("<I", 1 << 30))), "length"),
    "text that is no UTF-8": (
        file(record(Op.METADATA, struct.pack("<I", 1) + b"\xff" + text(""))),
        "length",
    ),
    "short message": (file(SCHEMA, CHANNEL, record(Op.MESSAGE, b"\1\0")), "length"),
    "message on no channel": (file(SCHEMA, CHANNEL, UNKNOWN_MESSAGE), "known"),
    "channel with no schema": (file(CHANNEL), "known"),
    "schema 0": (
        file(record(Op.SCHEMA, struct.pack("<H", 0) + text("") + text("") + text(""))),
        "known",
    ),
    "schema defined twice": (
        file(SCHEMA, record(Op.SCHEMA, struct.pack("<H", 1) + text("other") + text("") + text(""))),
        "known",
    ),
    "channel defined twice": (
        file(
            SCHEMA,
            CHANNEL,
            record(Op.CHANNEL, struct.pack("<HH", 1, 1) + text("/u") + text("cdr") + text("")),
        ),
        "known",
    ),
    "key twice in a map": (
        file(record(Op.METADATA, text("m") + struct.pack("<I", 20) + (text("k") + text("v")) * 2)),
        "known",
    ),
    "chunk size too small": (file(chunk(INNER, size=len(INNER) - 1)), "chunk"),
    "chunk size too large": (file(chunk(INNER, size=len(INNER) + 1)), "chunk"),
    "chunk of a chunk": (file(chunk(chunk(INNER))), "chunk"),
    "chunk cut inside": (file(chunk(INNER[:-3])), "length"),
    "unknown compression": (file(chunk(INNER, compression="brotli")), "chunk"),
    "chunk that is no zstd": (file(chunk(INNER, compression="zstd")), "chunk"),
    "chunk that is no lz4": (file(chunk(INNER, compression="lz4")), "chunk"),
    "cut lz4": (
        file(chunk(INNER, compression="lz4", stored=lz4.frame.compress(INNER)[:-4])),
        "chunk",
    ),
    "zstd of more than declared": (
        file(chunk(b"", compression="zstd", size=1000, stored=BOMB)),
        "chunk",
    ),
    "lz4 of more than declared": (
        file(chunk(b"", compression="lz4", size=1000, stored=lz4.frame.compress(bytes(40 << 20)))),
        "chunk",
    ),
    "chunk checksum": (file(chunk(INNER, crc=zlib.crc32(INNER) ^ 1)), "crc"),
    "data checksum": (file(SCHEMA, data_crc=12345), "crc"),
    "attachment checksum": (
        file(
            record(
                Op.ATTACHMENT,
                bytes(16) + text("") + text("") + struct.pack("<Q", 0) + struct.pack("<I", 7),
            )
        ),
        "crc",
    ),
    "summary checksum": (
        file(SCHEMA, footer=record(Op.FOOTER, struct.pack("<QQI", 0, 0, 99))),
        "crc",
    ),
    "summary elsewhere": (
        file(SCHEMA, footer=record(Op.FOOTER, struct.pack("<QQI", 12, 0, 0))),
        "index",
    ),
    "summary not declared": (
        file(SCHEMA, summary=SCHEMA, footer=record(Op.FOOTER, struct.pack("<QQI", 0, 0, 0))),
        "index",
    ),
    "statistics that do not count": (
        file(SCHEMA, CHANNEL, MESSAGE, summary=statistics(2)),
        "index",
    ),
    "index outside the file": (
        file(SCHEMA, summary=record(Op.METADATA_INDEX, struct.pack("<QQ", 1 << 40, 5) + text(""))),
        "index",
    ),
    "message index of half an entry": (
        file(SCHEMA, CHANNEL, record(Op.MESSAGE_INDEX, struct.pack("<HI", 1, 8) + bytes(8))),
        "index",
    ),
}


@pytest.mark.parametrize("name", BROKEN)
def test_a_broken_file_is_refused_with_its_rule_and_byte(name):
    data, rule = BROKEN[name]
    with pytest.raises(MalformedMcap) as refused:
        walk(data)
    assert refused.value.facts["rule"] == rule
    assert 0 <= refused.value.facts["byte"] <= len(data)


DATA = len(MAGIC) + len(record(Op.HEADER, text("") + text("")))  # where the first record begins
CULPRITS = {  # where the record begins that breaks the rule
    "no magic": 0,
    "two headers": DATA,
    "record kind 0": DATA,
    "length beyond the file": DATA,
    "chunk checksum": DATA,
    "cut lz4": DATA,
    "schema defined twice": DATA + len(SCHEMA),
    "channel defined twice": DATA + len(SCHEMA + CHANNEL),
    "message on no channel": DATA + len(SCHEMA + CHANNEL),
    "message index of half an entry": DATA + len(SCHEMA + CHANNEL),
    "bytes behind the end": len(SOUND),
}


@pytest.mark.parametrize("name", CULPRITS)
def test_the_byte_is_that_of_the_record_that_breaks_the_rule(name):
    with pytest.raises(MalformedMcap) as refused:
        walk(BROKEN[name][0])
    assert refused.value.facts["byte"] == CULPRITS[name]


LARGE = {
    "file": (SOUND, Limits(file_bytes=10), "file_bytes"),
    "record": (SOUND, Limits(record_bytes=3), "record_bytes"),
    "chunk": (file(chunk(INNER)), Limits(chunk_bytes=5), "chunk_bytes"),
    "ratio": (
        file(chunk(b"", compression="zstd", size=40 << 20, stored=BOMB)),
        LIMITS,
        "unfold_ratio",
    ),
    "ratio of all chunks together": (
        file(
            *[
                chunk(
                    b"",
                    compression="zstd",
                    stored=zstandard.ZstdCompressor().compress(EMPTY),
                    size=len(EMPTY),
                )
            ]
            * 9
        ),
        LIMITS,
        "unfold_ratio",
    ),
    "definitions": (
        file(
            *(
                record(Op.SCHEMA, struct.pack("<H", i) + text("s") + text("") + text("x" * 999))
                for i in range(1, 9)
            )
        ),
        Limits(definition_bytes=5000),
        "definition_bytes",
    ),
    "records": (file(SCHEMA, CHANNEL, MESSAGE * 50), Limits(records=20), "records"),
    "records of a chunk": (
        file(chunk(SCHEMA + CHANNEL + MESSAGE * 50)),
        Limits(records=20),
        "records",
    ),
    "channels": (
        file(
            SCHEMA,
            *(
                record(Op.CHANNEL, struct.pack("<HH", i, 1) + text("/t") + text("") + text(""))
                for i in range(9)
            ),
        ),
        Limits(channels=8),
        "channels",
    ),
}


@pytest.mark.parametrize("name", LARGE)
def test_a_limit_is_held(name):
    data, limits, limit = LARGE[name]
    with pytest.raises(TooLarge) as refused:
        walk(data, limits)
    assert refused.value.facts["limit"] == limit


WHOLE = file(SCHEMA, CHANNEL, chunk(MESSAGE * 3), MESSAGE, summary=statistics(4, 1))


@settings(max_examples=300)
@given(st.integers(0, len(WHOLE) - 1), st.integers(1, 255))
def test_a_flipped_byte_is_read_or_refused_but_never_anything_else(at, by):
    data = bytearray(WHOLE)
    data[at] ^= by
    with contextlib.suppress(BadEpisode):
        walk(bytes(data))
