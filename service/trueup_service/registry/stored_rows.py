"""Rows of any table as they are stored, for audits, archives and garbage collection."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from sqlalchemy import Table, literal, select, tuple_

from trueup.canonical import Json
from trueup_service.registry import tables as t
from trueup_service.registry.records import ImportRecord
from trueup_service.registry.repository import Repository, TableGateway
from trueup_service.registry.row_format import json_from_row, row_from_json

NAMING_BLOBS = (t.episodes.c.digest, t.artifacts.c.arrays, t.imports.c.entries, t.outputs.c.digest)


class Imports(Repository[ImportRecord]):
    """Where imported plants came from."""

    table, record = t.imports, ImportRecord


class StoredRows:
    """Rows of every table as JSON."""

    def __init__(self, gateway: TableGateway) -> None:
        self._gateway = gateway
        self._connection = gateway.connection

    def page(
        self, table: Table, after: Sequence[Any], limit: int, plant: str | None = None
    ) -> list[dict[str, Json]]:
        """Rows in the order of their primary keys from behind one key, which is empty at the
        beginning. Rows of one plant, or of all."""
        key = tuple(table.primary_key.columns)
        query = select(table).order_by(*key).limit(limit)
        if plant is not None:
            query = query.where((table.c.name if table is t.plants else table.c.plant) == plant)
        if after:
            values = (literal(v, c.type) for v, c in zip(after, key, strict=True))
            query = query.where(tuple_(*key) > tuple_(*values))
        return [json_from_row(table, row) for row in self._connection.execute(query).mappings()]

    def names_blob(self, digest: str) -> bool:
        """Whether any row names these bytes."""
        return any(
            self._connection.scalar(select(column).where(column == digest).limit(1)) is not None
            for column in NAMING_BLOBS
        )

    def import_row(self, table: Table, document: Mapping[str, Any]) -> None:
        """Add a row that another registry stored, which the next entry of the log names."""
        self._gateway.add_json(table, document)

    def restore_row(self, table: Table, document: Mapping[str, Any]) -> None:
        """Put a row back that the restored log names already."""
        self._gateway.insert(table, row_from_json(table, document))
