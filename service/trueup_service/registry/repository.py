"""What repositories are built on: the gateway to the tables, and one table's rows as records.

Every row that is written is noted by name and digest until the next entry of the log takes the
notes. A job is noted only once it is final, since its progress is not history.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields
from functools import cache
from types import MappingProxyType
from typing import Any, Generic, TypeVar

from sqlalchemy import (
    ColumnElement,
    Connection,
    Select,
    Table,
    Update,
    bindparam,
    insert,
    select,
    update,
)
from sqlalchemy.engine import RowMapping

from trueup.ledger.rows import KEYS, row_digest, row_name
from trueup_service.registry import tables as t
from trueup_service.registry.row_format import (
    json_from_row,
    record_from_row,
    row_from_json,
    row_from_values,
)

R = TypeVar("R")
IN_CLAUSE = 500  # values that one statement names

# Statements that do not change are built once: building one costs about as much as running it.
_INSERT = {name: insert(table) for name, table in t.metadata.tables.items()}


@cache
def _row_by(table: str, columns: tuple[str, ...]) -> Select[Any]:
    selected = t.metadata.tables[table]
    return select(selected).where(*(selected.c[name] == bindparam(name) for name in columns))


@cache
def _last_by(table: str, columns: tuple[str, ...], order: str) -> Select[Any]:
    last_first = t.metadata.tables[table].c[order].desc()
    return _row_by(table, columns).order_by(last_first).limit(1)


class TableGateway:
    """Reads and writes the rows of any table inside one transaction, and notes the written rows
    that no entry of the log names yet."""

    def __init__(self, connection: Connection, *, writable: bool) -> None:
        self.connection = connection
        self.unlogged: dict[str, str] = {}  # the name of a row, and its digest
        self._writable = writable

    def one(
        self, kind: type[R], table: Table, query: Select[Any], values: Mapping[str, Any]
    ) -> R | None:
        """The first row of a query as a record, None where there is none."""
        row = self.connection.execute(query, values).mappings().first()
        return None if row is None else record_from_row(kind, table, row)

    def all(
        self,
        kind: type[R],
        table: Table,
        query: Select[Any],
        values: Mapping[str, Any] = MappingProxyType({}),
    ) -> list[R]:
        """Every row of a query as a record."""
        rows = self.connection.execute(query, values).mappings()
        return [record_from_row(kind, table, row) for row in rows]

    def in_parts(
        self,
        query: Select[Any],
        name: str,
        values: Sequence[str],
        others: Mapping[str, Any] = MappingProxyType({}),
    ) -> Iterator[Any]:
        """The rows of a query whose parameter `name` takes a list, which may be longer than one
        statement can name. With `others`, for its other parameters, a row may come once for each
        part of the list, and the query is also run where the list is empty."""
        for begin in range(0, max(len(values), bool(others)), IN_CLAUSE):
            part = {name: list(values[begin : begin + IN_CLAUSE])}
            yield from self.connection.execute(query, {**others, **part})

    def insert(self, table: Table, row: Mapping[str, Any] | list[dict[str, Any]]) -> None:
        """Store rows that the log names already, or does not name."""
        if not self._writable:
            raise TypeError("this transaction only reads")
        self.connection.execute(_INSERT[table.name], row)

    def add(self, table: Table, values: Mapping[str, Any]) -> None:
        """Store a new row, and note it for the log."""
        row = row_from_values(table, values)
        self.insert(table, row)
        if table is not t.jobs:  # a job is named once it is final
            self.note(table, row)

    def add_json(self, table: Table, document: Mapping[str, Any]) -> None:
        """Store a row that an archive brought, and note it for the log."""
        row = row_from_json(table, document)
        self.insert(table, row)
        self.note(table, row)

    def update(self, statement: Update, *where: ColumnElement[bool], **values: Any) -> bool:
        """Change the one row that the conditions name, and say whether there was one."""
        return self.run_update(statement.where(*where).values(values), {})

    def run_update(self, statement: Update, parameters: Mapping[str, Any]) -> bool:
        """Change the one row that a statement built before names, and say whether there was
        one."""
        if not self._writable:
            raise TypeError("this transaction only reads")
        return self.connection.execute(statement, parameters).rowcount == 1

    def note_changed(self, table: Table, *where: ColumnElement[bool]) -> None:
        """Read a row that was changed, and note it for the log."""
        self.note(table, self.connection.execute(select(table).where(*where)).mappings().one())

    def note(self, table: Table, row: Mapping[str, Any] | RowMapping) -> None:
        """Note a row as it is stored now, for the next entry of the log."""
        if table.name in KEYS:
            document = json_from_row(table, row)
            self.unlogged[row_name(table.name, document)] = row_digest(table.name, document)

    def take_notes(self) -> dict[str, str]:
        """The names and digests of the rows written since the last entry of the log, which an entry
        takes over."""
        notes, self.unlogged = self.unlogged, {}
        return notes


class Repository(Generic[R]):
    """The rows of one table as records of one kind. The record's fields are the table's columns."""

    table: Table
    record: type[R]

    def __init__(self, gateway: TableGateway) -> None:
        self._gateway = gateway
        self._connection = gateway.connection

    def add(self, record: R) -> None:
        """Add a record as a row, which the next entry of the log names."""
        self._gateway.add(self.table, values_of(record))

    def _end_once(self, of: ColumnElement[bool], how: str, now: str, actor: str) -> bool:
        """Mark the one row that a condition names as ended, in the columns `<how>_at` and
        `<how>_by`. Returns False, and changes nothing, where it is marked already."""
        ended = self._gateway.update(
            update(self.table),
            of,
            self.table.c[f"{how}_at"].is_(None),
            **{f"{how}_at": now, f"{how}_by": actor},
        )
        if ended:
            self._gateway.note_changed(self.table, of)
        return ended

    def _by(self, **values: Any) -> R | None:
        """The record with these values in its columns, which name it."""
        return self._one(_row_by(self.table.name, tuple(values)), **values)

    def _last(self, order: str, **values: Any) -> R | None:
        """Of the records with these values in their columns the last one in the order of
        another."""
        return self._one(_last_by(self.table.name, tuple(values), order), **values)

    def _one(self, query: Select[Any], **values: Any) -> R | None:
        return self._gateway.one(self.record, self.table, query, values)

    def _all(self, query: Select[Any], values: Mapping[str, Any] = MappingProxyType({})) -> list[R]:
        return self._gateway.all(self.record, self.table, query, values)

    def _record(self, row: Any) -> R:
        return record_from_row(self.record, self.table, row._mapping)

    def _page(
        self, cursor: ColumnElement[Any], after: Any, limit: int, *where: ColumnElement[bool]
    ) -> list[R]:
        """Records in the order of a unique column, from behind a value of it."""
        query = select(self.table).where(*where, cursor > after)
        return self._all(query.order_by(cursor).limit(limit))

    def _newest(
        self,
        time: ColumnElement[str],
        tie_break: ColumnElement[str],
        before: str,
        limit: int,
        *where: ColumnElement[bool],
    ) -> list[R]:
        """Records from before a time, the newest first."""
        query = select(self.table).where(*where, time < before)
        return self._all(query.order_by(time.desc(), tie_break).limit(limit))


def values_of(record: Any) -> dict[str, Any]:
    """The fields of a record by name."""
    return {field.name: getattr(record, field.name) for field in fields(record)}
