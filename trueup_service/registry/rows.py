"""Rows of our tables as JSON, in which the log names them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from sqlalchemy import BigInteger, Column, RowMapping, Table

from trueup.canonical import Json


def plain(table: Table, values: Mapping[str, Any] | RowMapping) -> dict[str, Json]:
    """A row's columns as JSON; numbers that JSON does not hold exactly (64-bit integers) are text, bytes are hexadecimal."""
    return {column.name: _plain(column, values[column.name]) for column in table.columns}


def stored(table: Table, row: Mapping[str, Any]) -> dict[str, Any]:
    """The inverse: a row as it is stored."""
    wide = {c.name for c in table.columns if isinstance(c.type, BigInteger)}
    return {name: int(value) if name in wide and value is not None else value for name, value in row.items()}


def _plain(column: Column[Any], value: Any) -> Json:
    if isinstance(value, bytes | memoryview):
        return value.hex()
    wide = isinstance(column.type, BigInteger) and value is not None
    found: Json = str(value) if wide else value
    return found
