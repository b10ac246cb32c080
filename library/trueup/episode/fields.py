"""Read the fields of one record, never past its end."""

from __future__ import annotations

from trueup.errors import MalformedMcap


class Fields:
    """A cursor over the body of one MCAP record.

    `byte` is where the record lies in the file and stands in every MalformedMcap that is raised.
    """

    __slots__ = ("_body", "_byte", "at")

    def __init__(self, body: bytes | memoryview, byte: int) -> None:
        self._body = memoryview(body)
        self._byte = byte
        self.at = 0

    def skip(self, length: int) -> memoryview:
        """The next `length` bytes."""
        if length > len(self._body) - self.at:
            raise MalformedMcap(
                f"a field of {length} bytes does not fit its record", rule="length", byte=self._byte
            )
        self.at += length
        return self._body[self.at - length : self.at]

    def uint(self, width: int) -> int:
        """A little-endian unsigned integer of `width` bytes."""
        return int.from_bytes(self.skip(width), "little")

    def block(self) -> memoryview:
        """Bytes behind a 32-bit length."""
        return self.skip(self.uint(4))

    def long_block(self) -> memoryview:
        """Bytes behind a 64-bit length."""
        return self.skip(self.uint(8))

    def text(self) -> str:
        """A UTF-8 string behind a 32-bit length."""
        try:
            return str(self.block(), "utf-8")
        except UnicodeDecodeError as error:
            raise MalformedMcap("a string is not UTF-8", rule="length", byte=self._byte) from error

    def text_map(self) -> dict[str, str]:
        """A map of strings behind a 32-bit length in bytes; a key may stand once."""
        inner = Fields(self.block(), self._byte)
        entries: dict[str, str] = {}
        while inner.at < len(inner._body):
            key, value = inner.text(), inner.text()
            if key in entries:
                raise MalformedMcap(
                    f"the key {key!r} stands twice in a map", rule="known", byte=self._byte
                )
            entries[key] = value
        return entries
