"""How the command shows things: tables and colours for people, lines in a pipe, JSON for programs,
progress on standard error.

Every command prints through here, for much of what it prints was written by somebody else: a robot,
a server, a file's name.
- Markup and line ends are read in our own forms alone: `say` takes a form that stands in the code,
  and values that fill it.
- What a value holds that cannot be seen is shown escaped: control characters, C1 among them, and
  what turns the direction of text.
- JSON is ASCII, with everything else escaped.
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

from trueup.diagnose.summary_text import sentence, warnings

out = Console(
    highlight=False, soft_wrap=not sys.stdout.isatty()
)  # in a pipe nothing is broken into lines of a terminal's width
err = Console(stderr=True, highlight=False, soft_wrap=not sys.stderr.isatty())


FIELD = re.compile(
    r"\{(?::([^{}]*))?\}"
)  # where a value goes in a form: {}, or {:.3g} with how it is written


def visible(value: object) -> str:
    """A value as text in one line, every character of which is seen: others are written as Python
    escapes them, such as \\x1b."""
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in str(value))


def filled(form: LiteralString, *values: object) -> Text:
    """A form of ours in rich's markup, its fields filled with values that are no markup. Raises
    ValueError unless they are as many."""
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
    """Print a sentence of ours, with others' words in its fields."""
    to.print(filled(form, *values), soft_wrap=True)


def lines(text: str, to: Console = out) -> None:
    """Print text whose line ends and tabs belong to it, such as a script or a signed note."""
    shown = "\n".join(
        "\t".join(map(visible, line.split("\t"))) for line in text.removesuffix("\n").split("\n")
    )
    print(shown, file=to.file)


def as_json(value: Any) -> None:
    """Print a value as JSON."""
    print(json.dumps(value, indent=2, default=str))


def answer(report: Mapping[str, Any]) -> None:
    """Print a diagnosis's answer and what to know before it is used; names of joints are printed as
    they are."""
    say("{}", sentence(report))
    for warning in warnings(report):
        say("[yellow]{}[/]", warning)


def table(title: str, columns: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """Print a table; numbers stand to the right. In a pipe it is a line for each row, its cells
    between tabs, and nothing is cut."""
    if not out.is_terminal:
        for row in (columns, *rows):
            print("\t".join(str(cell(x)) for x in row))
        return
    made = Table(
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
        made.add_column(cell(name), justify="right" if numeric else "left", overflow="fold")
    for row in cells:
        made.add_row(*(cell(x) for x in row))
    out.print(made)


def cell(value: object) -> Text:
    """A value as a table shows it, whose tabs would part cells; a Text is ours and stays as it
    is."""
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
    """A bar on standard error, or one plain line where that is no terminal; call with the share
    done and what is being done."""
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
    """A time to the second, as a table shows it."""
    return at[:19].replace("T", " ")
