"""ROS messages of any defined type as trees whose numbers are places in the bytes.

ROS 2 writes the OMG Common Data Representation (DDS-XTypes 1.3, section 7.4.3), which aligns every
number; ROS 1 writes the same fields one behind the other.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Any, NamedTuple

from trueup.recording.message_tree import MOST_SIGNALS
from trueup.recording.ros_types import ARRAY, BASE, NAME, Types

HEAD_BYTES = 4
# of each kind of number its code in numpy, and its size [bytes]
KINDS = {
    "bool": ("?", 1),
    "byte": ("u1", 1),
    "char": ("u1", 1),
    "int8": ("i1", 1),
    "uint8": ("u1", 1),
    "int16": ("i2", 2),
    "uint16": ("u2", 2),
    "int32": ("i4", 4),
    "uint32": ("u4", 4),
    "int64": ("i8", 8),
    "uint64": ("u8", 8),
    "float32": ("f4", 4),
    "float64": ("f8", 8),
}
DEEPEST = 32  # of types within types


class Spot(NamedTuple):
    """Where a number stands in a message, and its numpy type with the order of its bytes."""

    at: int
    dtype: str
    size: int


class CdrTree:
    """One message, read once from its beginning to its end."""

    def __init__(self, types: Types, data: bytes, *, is_ros1: bool) -> None:
        self._types, self._data, self._is_ros1 = types, data, is_ros1
        self._at, self._order = 0, "<"
        self.numbers: list[tuple[int, int]] = []  # where they begin, and how long they are
        if not is_ros1:
            if len(data) < HEAD_BYTES or data[0] != 0 or data[1] not in (0, 1):
                raise ValueError("its encapsulation is not plain CDR")
            self._at, self._order = HEAD_BYTES, "<" if data[1] else ">"

    def read(self, name: str, depth: int = 0) -> dict[str, Any]:
        """The fields of a type from here on. Raises ValueError, struct.error."""
        if depth > DEEPEST:
            raise ValueError("its types are nested too deeply")
        if name not in self._types:
            raise ValueError(f"the type {name} is not defined")
        fields = self._types[name][1]
        if not fields and not self._is_ros1:
            self._skip(1, 1)  # a structure without fields takes one byte
        return {field: self._value(description, depth) for field, description in fields}

    @property
    def is_whole(self) -> bool:
        """Whether nothing but padding is left of the message."""
        return 0 <= len(self._data) - self._at < (1 if self._is_ros1 else HEAD_BYTES)

    def _value(self, description: Any, depth: int) -> Any:
        kind, what = description
        if kind == BASE:
            return self._base(what[0])
        if kind == NAME:
            return self.read(what, depth + 1)
        inner, length = what
        return self._list(inner, length if kind == ARRAY else self._count(), depth)

    def _list(self, inner: Any, count: int, depth: int) -> list[Any]:
        if count > len(self._data):
            raise ValueError(f"it declares {count} entries")
        base = inner[1][0] if inner[0] == BASE else None
        if base in KINDS and count:
            code, size = KINDS[base]
            first = self._number(size, size * count)
            kept = count if count <= MOST_SIGNALS and code != "u1" else 0
            return [Spot(first + i * size, self._order + code, size) for i in range(kept)]
        return [self._value(inner, depth) for _ in range(count)]

    def _base(self, base: str) -> Any:
        if base in ("string", "wstring"):
            return self._text(2 if base == "wstring" else 1)
        if base not in KINDS:
            raise ValueError(f"numbers of the kind {base} are not read")
        code, size = KINDS[base]
        return Spot(self._number(size, size), self._order + code, size)

    def _number(self, alignment: int, length: int) -> int:
        at = self._skip(alignment, length)
        self.numbers.append((at, length))
        return at

    def _text(self, width: int) -> str:
        length = self._count()
        at = self._skip(1, length * width)
        data = self._data[at : at + length * width]
        return data.rstrip(b"\0").decode(errors="replace") if width == 1 else ""

    def _count(self) -> int:
        at = self._skip(4, 4)
        return int(struct.unpack_from(self._order + "I", self._data, at)[0])

    def _skip(self, alignment: int, length: int) -> int:
        """Goes past a value of `length` bytes, and returns where it stands. Alignment counts from
        behind the head."""
        at = self._at + (0 if self._is_ros1 else (HEAD_BYTES - self._at) % alignment)
        if at + length > len(self._data):
            raise ValueError("a value does not fit it")
        self._at = at + length
        return at


@dataclass(frozen=True, slots=True)
class CdrMessage:
    """The fields of a message, with places for numbers; and of every number in it where it begins
    and how long it is [bytes]."""

    fields: dict[str, Any]
    numbers: list[tuple[int, int]]


def read_message(types: Types, name: str, data: bytes, *, is_ros1: bool = False) -> CdrMessage:
    """One message. Raises ValueError where it is not of that type."""
    tree = CdrTree(types, data, is_ros1=is_ros1)
    try:
        fields = tree.read(name)
    except (struct.error, RecursionError) as error:
        raise ValueError(str(error)) from error
    if not tree.is_whole:
        raise ValueError("it is longer than its type")
    return CdrMessage(fields, tree.numbers)
