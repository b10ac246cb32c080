"""How the log named its rows and hashed its entries when change 0003 was made.

A copy on purpose: the live code may grow, and an old database must still be brought to the same
log.

- A row is named `table/key`; its digest is over its columns by name, without the empty ones.
- 64-bit integers are text, bytes are hexadecimal, documents are the text that is stored.
- Canonical bytes are RFC 8785; the tree is that of RFC 9162, section 2.1.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from typing import Any

import rfc8785
import sqlalchemy as sa

KEYS: Mapping[str, tuple[str, ...]] = {
    "plants": ("name",),
    "episodes": ("plant", "digest"),
    "artifacts": ("plant", "version"),
    "gates": ("plant", "digest"),
    "jobs": ("id",),
    "decisions": ("digest",),
    "serving": ("plant",),
    "moves": ("plant", "generation"),
    "monitors": ("plant", "digest"),
    "watching": ("plant",),
    "watches": ("plant", "monitor", "sequence"),
    "alarms": ("id",),
    "policies": ("plant", "sequence"),
    "evidence": ("plant", "digest"),
    "channels": ("plant", "name"),
    "channel_moves": ("plant", "channel", "generation"),
}
# integers that JSON holds exactly, and those written without an exponent
EXACT, LARGEST_PLAIN = 2**53 - 1, 10**21
POSITION_BITS = 48


def canonical(value: Any) -> bytes:
    """The RFC 8785 bytes of a JSON value."""
    try:
        return rfc8785.dumps(value)
    except rfc8785.IntegerDomainError:
        return rfc8785.dumps(_large_integers_as_floats(value))


def row_name(table: str, row: Mapping[str, Any]) -> str:
    """The log's name of a row."""
    return "/".join((table, *(str(row[column]) for column in KEYS[table])))


def row_digest(table: sa.Table, row: Mapping[str, Any]) -> str:
    """The SHA-256 of a row, in hexadecimal."""
    columns = {column.name: _plain(column, row[column.name]) for column in table.columns}
    return _sha256(
        canonical(
            {
                "table": table.name,
                "row": {name: value for name, value in columns.items() if value is not None},
            }
        )
    )


def leaf(entry: Mapping[str, Any], facts: Mapping[str, Any], rows: Mapping[str, str]) -> bytes:
    """The hash of an entry as a leaf of the tree."""
    named = {name: entry[name] for name in ("sequence", "at", "kind", "actor", "plant", "subject")}
    of = canonical(
        {
            **named,
            "facts_sha256": _sha256(canonical(facts)),
            "rows_sha256": _sha256(canonical(rows)),
        }
    )
    return hashlib.sha256(b"\x00" + of).digest()


def append(frontier: list[bytes], size: int, hashed: bytes) -> dict[int, bytes]:
    """Append a leaf to the tree of `size` leaves; the subtrees that it completes, by the number
    under which each is kept."""
    node, level, position = hashed, 0, size
    completed = {position: node}
    while position & 1:
        level, position, node = (
            level + 1,
            position >> 1,
            hashlib.sha256(b"\x01" + frontier.pop() + node).digest(),
        )
        completed[level << POSITION_BITS | position] = node
    frontier.append(node)
    return completed


def _sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def _plain(column: sa.Column[Any], value: Any) -> Any:
    if isinstance(value, bytes | memoryview):
        return value.hex()
    return str(value) if isinstance(column.type, sa.BigInteger) and value is not None else value


def _large_integers_as_floats(value: Any) -> Any:
    """A float such as 1e17 is written without a point and read back as an integer: here it is a
    float again."""
    if isinstance(value, Mapping):
        return {key: _large_integers_as_floats(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_large_integers_as_floats(item) for item in value]
    if (
        isinstance(value, int)
        and EXACT < abs(value) < LARGEST_PLAIN
        and rfc8785.dumps(float(value)).decode() == str(value)
    ):
        return float(value)
    return value
