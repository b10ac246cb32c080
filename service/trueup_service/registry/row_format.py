"""Rows as the database stores them, as records, and as the JSON whose digest the log keeps."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar

import orjson
from sqlalchemy import BigInteger, Column, LargeBinary, RowMapping, Table

from trueup.canonical import Json, canonical_bytes
from trueup.errors import BrokenChain
from trueup_service.registry.columns import DOCUMENT
from trueup_service.registry.tables import metadata

R = TypeVar("R")
DOCUMENT_COLUMNS: Mapping[str, frozenset[str]] = {
    table.name: frozenset(c.name for c in table.columns if c.info.get(DOCUMENT))
    for table in metadata.tables.values()
}


def record_from_row(kind: type[R], table: Table, row: RowMapping) -> R:
    """The record of a row of a table: the record's fields are the table's columns, and the text of
    a document column is parsed."""
    documents = DOCUMENT_COLUMNS[table.name]
    return kind(
        **{
            name: orjson.loads(value) if name in documents and value is not None else value
            for name, value in row.items()
        }
    )


def row_from_values(table: Table, values: Mapping[str, Any]) -> dict[str, Any]:
    """The row that stores these values, by column; a document is stored as its canonical JSON."""
    documents = DOCUMENT_COLUMNS[table.name]
    return {
        name: document_text(value) if name in documents and value is not None else value
        for name, value in values.items()
    }


def document_text(document: Any) -> str:
    """A document as a column stores it: canonical JSON."""
    return canonical_bytes(document).decode()


def json_from_row(table: Table, row: Mapping[str, Any] | RowMapping) -> dict[str, Json]:
    """A stored row as JSON. Integers of 64 bits, which JSON does not hold exactly, become text, and
    bytes become hexadecimal text.

    Raises BrokenChain where a column of text or numbers holds bytes. Some databases accept such a
    row, and this service never writes one.
    """
    return {column.name: _json_value(column, row[column.name]) for column in table.columns}


def row_from_json(table: Table, document: Mapping[str, Any]) -> dict[str, Any]:
    """The stored row that `json_from_row` made this JSON of."""
    wide = {column.name for column in table.columns if isinstance(column.type, BigInteger)}
    return {
        name: int(value) if name in wide and value is not None else value
        for name, value in document.items()
    }


def _json_value(column: Column[Any], value: Any) -> Json:
    if isinstance(value, bytes | memoryview):
        if not isinstance(column.type, LargeBinary):
            raise BrokenChain(
                f"a row of {column.table.name} holds bytes in its column {column.name}, "
                "which no program of ours writes"
            )
        return value.hex()
    is_wide = isinstance(column.type, BigInteger) and value is not None
    json_value: Json = str(value) if is_wide else value
    return json_value
