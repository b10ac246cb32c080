"""Rows of our tables as JSON, in which the log names them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from sqlalchemy import BigInteger, Column, LargeBinary, RowMapping, Table

from trueup.canonical import Json
from trueup.errors import BrokenChain


def plain(table: Table, values: Mapping[str, Any] | RowMapping) -> dict[str, Json]:
    """A row's columns as JSON; numbers that JSON does not hold exactly (64-bit integers) are text,
    bytes are hexadecimal.

    Raises BrokenChain where a column of text or numbers holds bytes, which some databases take:
    nothing here writes such a row.
    """
    return {column.name: _plain(column, values[column.name]) for column in table.columns}


def stored(table: Table, row: Mapping[str, Any]) -> dict[str, Any]:
    """The inverse: a row as it is stored."""
    wide = {c.name for c in table.columns if isinstance(c.type, BigInteger)}
    return {
        name: int(value) if name in wide and value is not None else value
        for name, value in row.items()
    }


def _plain(column: Column[Any], value: Any) -> Json:
    if isinstance(value, bytes | memoryview):
        if not isinstance(column.type, LargeBinary):
            raise BrokenChain(
                f"a row of {column.table.name} holds bytes in its column {column.name}, "
                "which no program of ours writes"
            )
        return value.hex()
    wide = isinstance(column.type, BigInteger) and value is not None
    found: Json = str(value) if wide else value
    return found
