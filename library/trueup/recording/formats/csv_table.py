"""Comma-separated values, and what goes by that name: semicolons with decimal commas, tabs.

Rules of a file, each named in the error that it raises with the line at which it is broken:
- text: it is UTF-8;
- header: its first line names the columns;
- row: every line has as many cells as the header;
- number: in a column whose first cells are numbers, every cell is a number, a date or empty.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any, TextIO

import numpy as np
from numpy.typing import NDArray

from trueup.episode.container import Limits
from trueup.errors import MalformedRecording, TooLarge
from trueup.recording.format import Format
from trueup.recording.table import TableRecording

BLOCK_ROWS, LOOKED_AT_ROWS = 16384, 100
LINE_CHARACTERS, MOST_COLUMNS = 1 << 20, 4096
DELIMITERS = ",;\t"
EMPTY = ("", "nan", "NaN", "NAN", "null", "None", "NA", "N/A", "-")


class Csv(Format):
    """Source: RFC 4180, and what spreadsheets write in its place."""

    name = "csv"
    suffixes = (".csv", ".tsv", ".txt")

    def knows(self, path: Path, head: bytes) -> bool:
        return path.is_file() and (path.suffix in self.suffixes or _is_text(head))

    def recordings(self, path: Path, limits: Limits) -> Sequence[TableRecording]:
        form = _form(path)

        def blocks(names: Sequence[str]) -> Iterator[Mapping[str, NDArray[Any]]]:
            yield from _blocks(path, form, names)

        return [TableRecording(path.stem, self.name, form.numeric, blocks)]


def _is_text(head: bytes) -> bool:
    """Whether a file begins as a table does: printable, with a delimiter in its first line."""
    line = head.split(b"\n", 1)[0]
    return b"\0" not in head and any(d.encode() in line for d in DELIMITERS)


@dataclass(frozen=True, slots=True)
class _Form:
    """How a file is written: its delimiter, its decimal sign, its columns, and which of them hold
    numbers or dates."""

    delimiter: str
    decimal: str
    columns: tuple[str, ...]
    numeric: tuple[str, ...]


def _form(path: Path) -> _Form:
    try:
        with _open(path) as file:
            line = file.readline(LINE_CHARACTERS)
    except UnicodeDecodeError as error:
        raise MalformedRecording(
            f"{path.name} is not UTF-8: {error}", rule="text", line=1
        ) from error
    delimiter = max(DELIMITERS, key=line.count)
    with _open(path) as file:
        rows = list(islice(_rows(file, delimiter, path.name), LOOKED_AT_ROWS + 1))
    if not rows or all(_is_number(cell, ".") for cell in rows[0][1] if cell.strip()):
        raise MalformedRecording(
            f"{path.name} does not begin with the names of its columns",
            rule="header",
            line=1,
            hint="Put a first line above the numbers, such as time_s,q_rad,v_rad_s,u_nm.",
        )
    columns = tuple(cell.strip() for cell in rows[0][1])
    if len(columns) > MOST_COLUMNS:
        raise TooLarge(f"{path.name} has {len(columns)} columns", limit="columns", byte=0)
    cells = [row for _, row in rows[1:]]
    decimal = "," if delimiter != "," and _has_decimal_commas(cells) else "."
    numeric = tuple(
        name
        for at, name in enumerate(columns)
        if name and _holds_numbers([row[at] for row in cells if at < len(row)], decimal)
    )
    return _Form(delimiter, decimal, columns, numeric)


def _open(path: Path) -> TextIO:
    return path.open(encoding="utf-8-sig", newline="")


def _rows(file: TextIO, delimiter: str, name: str) -> Iterator[tuple[int, list[str]]]:
    """The rows that are not empty, each with its line. Raises MalformedRecording."""
    reader = csv.reader(file, delimiter=delimiter, strict=True)
    try:
        for row in reader:
            if row and not (len(row) == 1 and not row[0].strip()):
                yield reader.line_num, row
    except UnicodeDecodeError as error:
        raise MalformedRecording(
            f"{name} is not UTF-8: {error}", rule="text", line=reader.line_num + 1
        ) from error
    except csv.Error as error:
        raise MalformedRecording(f"{name}: {error}", rule="row", line=reader.line_num) from error


def _blocks(path: Path, form: _Form, names: Sequence[str]) -> Iterator[Mapping[str, NDArray[Any]]]:
    at = [form.columns.index(name) for name in names]
    with _open(path) as file:
        rows = _rows(file, form.delimiter, path.name)
        next(rows)
        while block := list(islice(rows, BLOCK_ROWS)):
            short = next((line for line, r in block if len(r) != len(form.columns)), None)
            if short is not None:
                raise MalformedRecording(
                    f"line {short} of {path.name} has not {len(form.columns)} cells, as its "
                    "header has",
                    rule="row",
                    line=short,
                )
            yield {
                name: _parsed([row[column] for _, row in block], form.decimal, path, name, block)
                for name, column in zip(names, at, strict=True)
            }


def _parsed(
    cells: list[str], decimal: str, path: Path, name: str, block: list[tuple[int, list[str]]]
) -> NDArray[Any]:
    """A column's cells as numbers, or as dates. Raises MalformedRecording."""
    if decimal == ",":
        cells = [c.replace(",", ".") for c in cells]
    try:
        return np.array(cells, np.float64)
    except ValueError:
        pass
    plain = [c.strip() for c in cells]
    missing = np.array([c in EMPTY for c in plain])
    kept = ["nan" if m else c for c, m in zip(plain, missing, strict=True)]
    try:
        return np.array(kept, np.float64)
    except ValueError:
        pass
    try:
        return np.array([_date(c, is_missing=m) for c, m in zip(plain, missing, strict=True)])
    except ValueError:
        wrong = next(i for i, c in enumerate(kept) if not _is_number(c, "."))
        raise MalformedRecording(
            f"line {block[wrong][0]} of {path.name} holds {plain[wrong][:40]!r} in the column "
            f"{name!r}, which is no number",
            rule="number",
            line=block[wrong][0],
            column=name,
        ) from None


def _date(text: str, *, is_missing: bool) -> np.datetime64:
    """A date of ISO 8601, in UTC where it says Z or +00:00. Raises ValueError."""
    plain = text.removesuffix("Z").removesuffix("+00:00").replace(" ", "T")
    if not is_missing and not ("-" in plain[1:] or ":" in plain):
        raise ValueError(text)
    return np.datetime64("NaT" if is_missing else plain, "ns")


def _is_number(cell: str, decimal: str) -> bool:
    try:
        float(cell.replace(decimal, "."))
    except ValueError:
        return False
    return True


def _has_decimal_commas(rows: list[list[str]]) -> bool:
    cells = [c for row in rows for c in row if "," in c]
    return bool(cells) and all(_is_number(c, ",") for c in cells)


def _holds_numbers(cells: list[str], decimal: str) -> bool:
    """Whether cells are numbers, dates or empty, and not all of them empty."""
    filled = [c.strip() for c in cells if c.strip() not in EMPTY]
    if not filled:
        return False
    if all(_is_number(c, decimal) for c in filled):
        return True
    try:
        return all(not np.isnat(_date(c, is_missing=False)) for c in filled)
    except ValueError:
        return False


FORMAT = Csv()
