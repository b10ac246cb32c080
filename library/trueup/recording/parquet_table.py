"""Parquet files as columns of numbers, some rows at a time."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trueup.episode.container import Limits
from trueup.errors import MalformedRecording, TooLarge
from trueup.recording.format import optional, require_size

BLOCK_ROWS = 65536
MOST_COLUMNS, LIST_ENTRIES = 4096, 256


class ParquetTable:
    """The columns of numbers and dates of some Parquet files, one behind the other; of a column of
    lists of one length, each entry. `rows` are those to read, all if None; `names` what the entries
    of a list are called, by its column."""

    def __init__(
        self,
        paths: Sequence[Path],
        limits: Limits,
        rows: slice | None = None,
        names: Mapping[str, Sequence[str]] | None = None,
    ) -> None:
        self._parquet = optional("pyarrow.parquet", "tables", "Parquet")
        self._paths, self._limits, self._rows = tuple(paths), limits, rows
        self._names = names or {}
        try:
            self._of = self._columns_of(paths[0])
        except (OSError, ValueError, IndexError) as error:
            raise _malformed(paths[0], error) from error

    @property
    def columns(self) -> tuple[str, ...]:
        """The names of the columns."""
        return tuple(self._of)

    def _columns_of(self, path: Path) -> dict[str, tuple[str, int | None]]:
        """Of each column its column in the file, and which entry of its lists it is."""
        kinds = optional("pyarrow", "tables", "Parquet").types
        columns: dict[str, tuple[str, int | None]] = {}
        with self._opened(path) as file:
            for field in file.schema_arrow:
                if _is_number(kinds, field.type):
                    columns[field.name] = (field.name, None)
                elif _is_list(kinds, field.type) and _is_number(kinds, field.type.value_type):
                    entries = self._entries(file, field.name)
                    named = self._names.get(field.name, ())
                    for i in range(min(entries, LIST_ENTRIES)):
                        own = named[i] if len(named) == entries else f"[{i}]"
                        columns[f"{field.name}{own}"] = (field.name, i)
        return columns

    def _entries(self, file: Any, name: str) -> int:
        first = next(file.iter_batches(1, columns=[name]), None)
        return len(first.column(0)[0]) if first is not None and len(first) else 0

    def blocks(self, names: Sequence[str]) -> Iterator[Mapping[str, NDArray[Any]]]:
        """These columns, block by block. Raises MalformedRecording, TooLarge."""
        read = list(dict.fromkeys(self._of[name][0] for name in names))
        at = 0
        for path in self._paths:
            with self._opened(path) as file:
                if file.metadata.num_columns > MOST_COLUMNS:
                    raise TooLarge(f"{path.name} has too many columns", limit="columns", byte=0)
                for batch in self._batches(path, file, read):
                    begin, end = _within(self._rows, at, len(batch))
                    at += len(batch)
                    if begin < end:
                        part = batch.slice(begin, end - begin)
                        yield {n: self._column(part, n, path) for n in names}

    def _batches(self, path: Path, file: Any, read: list[str]) -> Iterator[Any]:
        try:
            for group in range(file.metadata.num_row_groups):
                self._allow(path, file.metadata.row_group(group))
            yield from file.iter_batches(BLOCK_ROWS, columns=read, use_threads=False)
        except (OSError, ValueError) as error:  # Arrow's errors are of these kinds
            raise _malformed(path, error) from error

    def _allow(self, path: Path, group: Any) -> None:
        """Raises TooLarge where a group of rows unfolds to more than is allowed."""
        limits = self._limits
        if group.total_byte_size > max(
            limits.unfold_free_bytes, limits.unfold_ratio * path.stat().st_size
        ):
            raise TooLarge(
                f"a group of rows of {path.name} unfolds to {group.total_byte_size} bytes",
                limit="unfold_ratio",
                byte=0,
            )

    def _column(self, batch: Any, name: str, path: Path) -> NDArray[Any]:
        column, entry = self._of[name]
        values = batch.column(batch.schema.get_field_index(column))
        if entry is not None:
            wide = np.asarray(values.flatten().to_numpy(zero_copy_only=False))
            if len(wide) % len(values) or len(wide) // len(values) <= entry:
                raise MalformedRecording(
                    f"the lists in the column {column!r} of {path.name} differ in length",
                    rule="row",
                    column=column,
                )
            return wide.reshape(len(values), -1)[:, entry]
        return np.asarray(values.to_numpy(zero_copy_only=False))

    def _opened(self, path: Path) -> Any:
        require_size(path, self._limits)
        try:
            return self._parquet.ParquetFile(path, memory_map=False, pre_buffer=False)
        except (OSError, ValueError) as error:
            raise _malformed(path, error) from error


def _malformed(path: Path, error: Exception) -> MalformedRecording:
    return MalformedRecording(f"{path.name} is no sound Parquet: {error}", rule="container")


def _within(rows: slice | None, at: int, count: int) -> tuple[int, int]:
    """Which of the `count` rows from the row `at` on are among the wanted ones."""
    if rows is None:
        return 0, count
    return max(0, rows.start - at), min(count, rows.stop - at)


def _is_number(kinds: Any, kind: Any) -> bool:
    tests = ("is_integer", "is_floating", "is_boolean", "is_timestamp", "is_duration")
    return any(getattr(kinds, test)(kind) for test in tests)


def _is_list(kinds: Any, kind: Any) -> bool:
    return any(
        getattr(kinds, test)(kind) for test in ("is_list", "is_large_list", "is_fixed_size_list")
    )
