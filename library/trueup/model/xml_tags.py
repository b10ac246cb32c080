"""XML tags: start tags as they stand in a text, so that one can be changed and nothing else."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from xml.parsers import expat
from xml.sax.saxutils import quoteattr

import numpy as np

ROUNDING = 1e-12  # of the largest number beside it


@dataclass(frozen=True, slots=True)
class Tag:
    """A start tag as it stands in a text: bytes `[first, last)`, its attributes, the place of its
    parent in the list of tags, and where its element ends."""

    name: str
    attributes: Mapping[str, str]
    first: int
    last: int
    parent: int
    end: int


def tags(text: str) -> list[Tag]:
    """Every start tag of a text, in its order."""
    begun: list[tuple[str, dict[str, str], int, int]] = []
    ends: dict[int, int] = {}
    open_: list[int] = [-1]
    data = text.encode()
    parser = expat.ParserCreate("utf-8")

    def began(name: str, attributes: dict[str, str]) -> None:
        begun.append((name, attributes, parser.CurrentByteIndex, open_[-1]))
        open_.append(len(begun) - 1)

    def ended(_: str) -> None:
        ends[open_.pop()] = parser.CurrentByteIndex

    parser.StartElementHandler = began
    parser.EndElementHandler = ended
    parser.Parse(data, True)
    made = []
    for i, (name, attributes, first, parent) in enumerate(begun):
        last = _end(data, first)
        closed = data[first:last].endswith(b"/>")
        made.append(
            Tag(name, attributes, first, last, parent, last if closed else _end(data, ends[i]))
        )
    return made


def _end(data: bytes, first: int) -> int:
    """Where a start tag ends: behind the first > outside quotes."""
    quote = 0
    for i in range(first, len(data)):
        if quote:
            quote = 0 if data[i] == quote else quote
        elif data[i] in b"\"'":
            quote = data[i]
        elif data[i] == ord(">"):
            return i + 1
    return len(data)


def is_closed(text: str, tag: Tag) -> bool:
    """Whether a tag ends its element itself."""
    return text.encode()[tag.first : tag.last].endswith(b"/>")


def start_tag(name: str, attributes: Mapping[str, str], closed: bool) -> str:
    """A start tag, or a whole element where it is closed."""
    written = "".join(f" {k}={quoteattr(v)}" for k, v in attributes.items())
    return f"<{name}{written}{'/>' if closed else '>'}"


def spaced(*numbers: object) -> str:
    """Numbers as an attribute; those that only rounding made are 0."""
    values = np.array(numbers, float)
    values[np.abs(values) < ROUNDING * np.abs(values).max()] = 0.0
    return " ".join(f"{x:.10g}" for x in values + 0.0)  # no zero of a negative sign


def ancestors(every: Sequence[Tag], at: int) -> list[int]:
    """A tag's parents, the nearest first."""
    line = []
    while (at := every[at].parent) >= 0:
        line.append(at)
    return line
