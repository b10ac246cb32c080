"""Tables in memory: pandas, polars and Arrow tables, numpy's structured arrays, mappings of arrays.

None of these libraries is imported: a table is whatever has named columns that numpy can read.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trueup.errors import NotAnEpisode
from trueup.recording.table import KINDS, TableRecording

Array = NDArray[Any]


def table_recording(table: Any, name: str = "table") -> TableRecording:
    """The recording that a table in memory is. A column of several numbers a row, `(rows, n)`,
    becomes n columns `name[0]`, …. Raises NotAnEpisode."""
    columns = spread(_columns(table), name)

    def blocks(names: Sequence[str]) -> Iterator[Mapping[str, Array]]:
        yield {n: columns[n] for n in names}

    return TableRecording(name, "table", tuple(columns), blocks)


def spread(arrays: Mapping[str, Array], name: str) -> dict[str, Array]:
    """The columns of numbers and dates among some arrays, equally long; of an array of several
    numbers a row, each. Raises NotAnEpisode."""
    columns: dict[str, Array] = {}
    for column, values in arrays.items():
        if values.dtype.kind not in KINDS:
            continue
        if values.ndim == 1:
            columns[column] = values
        elif values.ndim == 2:  # noqa: PLR2004  (rows, and numbers of a row)
            columns |= {f"{column}[{i}]": values[:, i] for i in range(values.shape[1])}
    lengths = {len(values) for values in columns.values()}
    if len(lengths) > 1:
        raise NotAnEpisode(
            f"the columns of {name} are not equally long: {', '.join(map(str, sorted(lengths)))}",
            rule="columns",
        )
    return columns


def _columns(table: Any) -> dict[str, Array]:
    if isinstance(table, np.ndarray) and table.dtype.names:
        return {n: table[n] for n in table.dtype.names}
    if isinstance(table, Mapping):
        return {str(n): _array(values) for n, values in table.items()}
    if hasattr(table, "column_names"):  # Arrow
        return {str(n): _array(table.column(n)) for n in table.column_names}
    if hasattr(table, "columns") and hasattr(table, "__getitem__"):  # pandas, polars
        return {str(n): _array(table[n]) for n in table.columns}
    raise NotAnEpisode(
        f"a {type(table).__name__} is no table that is known",
        rule="columns",
        hint="Give a pandas, polars or Arrow table, a structured array, or a dict of arrays.",
    )


def _array(values: Any) -> Array:
    array = np.asarray(values.to_numpy() if hasattr(values, "to_numpy") else values)
    if array.dtype == object:  # whole numbers with missing ones among them
        try:
            return np.array([np.nan if x is None else x for x in array], np.float64)
        except (TypeError, ValueError):
            return array
    return array
