"""Output of commands: tables and colours for people, lines in a pipe, JSON for programs, and
progress on standard error.

Every command prints through this module, because much of what it prints was written by others: a
robot, a server, the name of a file.
- Markup and line ends are read in forms of ours alone: `say` takes a form from the code, and values
  that fill it.
- Invisible characters of a value are shown escaped: control characters, C1 among them, and those
  that change the direction of text.
- JSON is ASCII, with all other characters escaped.
"""

from __future__ import annotations

import json
import re
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, LiteralString

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn
from rich.table import Table
from rich.text import Span, Text

from trueup.diagnose.summary_text import UNNAMED, sentence
from trueup.diagnose.summary_warnings import warnings

# in a pipe, lines are not broken at a terminal's width
out = Console(highlight=False, soft_wrap=not sys.stdout.isatty())
err = Console(stderr=True, highlight=False, soft_wrap=not sys.stderr.isatty())


# a field of a form: {}, or with a format specification, such as {:.3g}
FIELD = re.compile(r"\{(?::([^{}]*))?\}")


def visible(value: object) -> str:
    """Returns a value as text in one line, with invisible characters escaped as Python does."""
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in str(value))


def filled(form: LiteralString, *values: object) -> Text:
    """Returns a form in rich's markup, its fields filled with values whose markup is not read.

    Raises ValueError if there are more or fewer values than fields.
    """
    text, parts, at = Text.from_markup(form, emoji=False), Text(), 0
    for field, value in zip(FIELD.finditer(text.plain), values, strict=True):
        written = visible(format(value, field[1] or ""))
        styles = [
            Span(0, len(written), span.style) for span in text[field.start() : field.end()].spans
        ]
        parts.append_text(text[at : field.start()]).append_text(Text(written, spans=styles))
        at = field.end()
    return parts.append_text(text[at:])


def say(form: LiteralString, *values: object, to: Console = out) -> None:
    """Prints a form of ours, with values in its fields."""
    to.print(filled(form, *values), soft_wrap=True)


def lines(text: str, to: Console = out) -> None:
    """Prints text whose line ends and tabs belong to it, such as a script or a signed note."""
    shown = "\n".join(
        "\t".join(map(visible, line.split("\t"))) for line in text.removesuffix("\n").split("\n")
    )
    print(shown, file=to.file)


def ask(question: str) -> bool:
    """Asks a person, and returns whether the answer is yes, which it is if it is empty."""
    say("{} [dim]\\[Y/n][/]", question, to=err)
    return input().strip().lower() in ("", "y", "yes")


def as_json(value: Any) -> None:
    """Prints a value as JSON."""
    print(json.dumps(value, indent=2, default=str))


def show_diagnosis(report: Mapping[str, Any], names: Mapping[str, str] = UNNAMED) -> None:
    """Prints a diagnosis's answer, and its warnings; `names` are those of recordings by digest."""
    say("{}", sentence(report))
    for warning in warnings(report, names):
        say("[yellow]{}[/]", warning)


def table(title: str, columns: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """Prints a table, with numbers aligned to the right.

    In a pipe it is a line for each row, with tabs between the cells, and nothing is cut.
    """
    if not out.is_terminal:
        for row in (columns, *rows):
            print("\t".join(str(cell(x)) for x in row))
        return
    grid = Table(
        title=cell(title),
        title_justify="left",
        title_style="bold",
        header_style="dim",
        box=None,
        pad_edge=False,
    )
    cells = [list(row) for row in rows]
    for i, name in enumerate(columns):
        numeric = bool(cells) and all(
            isinstance(row[i], int | float) and not isinstance(row[i], bool) for row in cells
        )
        grid.add_column(cell(name), justify="right" if numeric else "left", overflow="fold")
    for row in cells:
        grid.add_row(*(cell(x) for x in row))
    out.print(grid)


def cell(value: object) -> Text:
    """Returns a value as a table shows it, without tabs. A Text is ours and stays as it is."""
    if isinstance(value, Text):
        return value
    if isinstance(value, bool):
        return Text("yes" if value else "no")
    if isinstance(value, float):
        return Text(f"{value:.5g}")
    return Text("" if value is None else visible(str(value).replace("\t", " ")))


Bar = Callable[[float, str], None]


def _no_bar(_share: float, _stage: str = "") -> None:
    return


@contextmanager
def progress(what: str) -> Iterator[Bar]:
    """Shows a bar on standard error; one plain line if that is not a terminal.

    The bar is called with the share that is done, 0 to 1, and the present stage.
    """
    began = time.monotonic()
    if not err.is_terminal:
        yield _no_bar
        say("{} … {:.1f} s", what, time.monotonic() - began, to=err)
        return
    columns = (
        TextColumn("{task.description:<34}", markup=False),
        BarColumn(28),
        TaskProgressColumn(),
        TimeElapsedColumn(),
        TextColumn("{task.fields[stage]}", style="dim", markup=False),
    )
    with Progress(*columns, console=err) as bars:
        bar = bars.add_task(visible(what), total=1.0, stage="")

        def move(share: float, stage: str = "") -> None:
            bars.update(bar, completed=share, stage=visible(stage))

        yield move
        bars.update(bar, completed=1.0, stage="")


def moment(at: str) -> str:
    """Returns a time to the second, as a table shows it."""
    return at[:19].replace("T", " ")
