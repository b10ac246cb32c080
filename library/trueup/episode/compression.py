"""Decompress a chunk to exactly its declared size, never to more."""

from __future__ import annotations

import lz4.frame
import zstandard

from trueup.errors import MalformedMcap


def decompress(compression: str, stored: memoryview, size: int, byte: int) -> bytes:
    """The `size` bytes that a chunk at file position `byte` unfolds to. Raises MalformedMcap."""
    if compression == "":
        data = bytes(stored)
    elif compression == "zstd":
        data = _zstd(stored, size, byte)
    elif compression == "lz4":
        data = _lz4(stored, size, byte)
    else:
        raise MalformedMcap(
            f"the compression {compression!r} is not known", rule="chunk", byte=byte
        )
    if len(data) != size:
        raise MalformedMcap(
            f"a chunk declares {size} bytes and holds {'more' if len(data) > size else len(data)}",
            rule="chunk",
            byte=byte,
        )
    return data


def _zstd(stored: memoryview, size: int, byte: int) -> bytes:
    try:
        with zstandard.ZstdDecompressor(max_window_size=1 << 27).stream_reader(
            stored, read_across_frames=True
        ) as reader:
            return reader.read(size + 1)
    except zstandard.ZstdError as error:
        raise MalformedMcap(
            f"a chunk is no zstd frame: {error}", rule="chunk", byte=byte
        ) from error


def _lz4(stored: memoryview, size: int, byte: int) -> bytes:
    reader = lz4.frame.LZ4FrameDecompressor()
    try:
        data = reader.decompress(bytes(stored), max_length=size + 1)
    except (RuntimeError, EOFError) as error:
        raise MalformedMcap(f"a chunk is no lz4 frame: {error}", rule="chunk", byte=byte) from error
    if not reader.eof and len(data) == size:
        data += reader.decompress(b"", max_length=1)
        if not reader.eof:
            raise MalformedMcap("a chunk's lz4 frame is cut off", rule="chunk", byte=byte)
    return bytes(data)
