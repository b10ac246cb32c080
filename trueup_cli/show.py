"""How the command shows things: tables and colours for people, lines in a pipe, JSON for programs, progress on standard error."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn
from rich.table import Table
from rich.text import Text

from trueup.diagnose.words import sentence, warnings

out = Console(highlight=False, soft_wrap=not sys.stdout.isatty())  # in a pipe nothing is broken into lines of a terminal's width
err = Console(stderr=True, highlight=False, soft_wrap=not sys.stderr.isatty())


def as_json(value: Any) -> None:
    """Print a value as JSON."""
    json.dump(value, sys.stdout, indent=2, default=str)
    print()


def answer(report: Mapping[str, Any]) -> None:
    """Print a diagnosis's answer and what to know before it is used; names of joints are printed as they are."""
    out.print(sentence(report), markup=False, soft_wrap=True)
    for warning in warnings(report):
        out.print(warning, style="yellow", markup=False, soft_wrap=True)


def table(title: str, columns: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """Print a table; numbers stand to the right. In a pipe it is a line for each row, its cells between tabs, and nothing is cut."""
    if not out.is_terminal:
        for row in (columns, *rows):
            print("\t".join(str(cell(x)).replace("\t", " ") for x in row))
        return
    made = Table(title=title, title_justify="left", title_style="bold", header_style="dim", box=None, pad_edge=False)
    cells = [list(row) for row in rows]
    for i, name in enumerate(columns):
        numeric = bool(cells) and all(isinstance(row[i], int | float) and not isinstance(row[i], bool) for row in cells)
        made.add_column(name, justify="right" if numeric else "left", overflow="fold")
    for row in cells:
        made.add_row(*(cell(x) for x in row))
    out.print(made)


def cell(value: object) -> str | Text:
    """A value as a table shows it; a Text keeps its colours, everything else is printed as it is."""
    if isinstance(value, Text):
        return value
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.5g}"
    return "" if value is None else escape(str(value)) if out.is_terminal else str(value)


Bar = Callable[[float, str], None]


def _no_bar(_share: float, _stage: str = "") -> None:
    return


@contextmanager
def progress(what: str) -> Iterator[Bar]:
    """A bar on standard error, or one plain line where that is no terminal; call with the share done and what is being done."""
    began = time.monotonic()
    if not err.is_terminal:
        yield _no_bar
        err.print(f"{what} … {time.monotonic() - began:.1f} s")
        return
    columns = (
        TextColumn("{task.description:<34}"),
        BarColumn(28),
        TaskProgressColumn(),
        TimeElapsedColumn(),
        TextColumn("[dim]{task.fields[stage]}"),
    )
    with Progress(*columns, console=err) as bars:
        bar = bars.add_task(what, total=1.0, stage="")

        def move(share: float, stage: str = "") -> None:
            bars.update(bar, completed=share, stage=stage)

        yield move
        bars.update(bar, completed=1.0, stage="")


def moment(at: str) -> str:
    """A time to the second, as a table shows it."""
    return at[:19].replace("T", " ")
