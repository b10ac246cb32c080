"""`trueup chapter`: the experiment that trueup grew from, run anew beside the published digits."""

from __future__ import annotations

from rich.text import Text

from trueup.chapter.figures import Table, Value, run_chapter
from trueup.chapter.published import PUBLISHED, printed_like
from trueup_cli.options import Json
from trueup_cli.show import as_json, progress, say, table


def chapter(*, as_json_: Json = False) -> None:
    """Run the chapter's experiment, and print every table beside the published digits.

    With --json it prints all figures, unrounded.
    """
    with progress("chapter") as bar:
        tables = run_chapter(lambda what, share: bar(share, what))
    if as_json_:
        as_json({t.title: t.rows for t in tables})
        return
    for run in tables:
        _show(run)
    compared = [
        _agrees(t, r, c, v) for t in tables for r, row in t.rows.items() for c, v in row.items()
    ]
    agree = sum(x is True for x in compared)
    say(
        "\n{} of {} published figures agree to the printed digit",
        agree,
        sum(x is not None for x in compared),
    )


def _show(run: Table) -> None:
    """Prints each row of a run, and below it the published digits, green where they agree."""
    columns = list(dict.fromkeys(c for row in run.rows.values() for c in row))
    rows: list[list[object]] = []
    for name, row in run.rows.items():
        digits = PUBLISHED.get(run.title, {}).get(name, {})
        rows.append([name, *(_cell(row[c], digits.get(c)) if c in row else "" for c in columns)])
        if digits:
            rows.append(
                [
                    Text("  published", "dim"),
                    *(_published(row[c], digits[c]) if c in digits else "" for c in columns),
                ]
            )
    say("")
    table(run.title, ["", *columns], rows)


def _cell(value: Value, digits: str | None) -> str:
    if digits is not None:
        return printed_like(value, digits)
    return f"{value:.5f}" if isinstance(value, float) else str(value)


def _published(value: Value, digits: str) -> Text:
    return Text(digits, "green" if printed_like(value, digits) == digits else "bold red")


def _agrees(run: Table, row: str, column: str, value: Value) -> bool | None:
    digits = PUBLISHED.get(run.title, {}).get(row, {}).get(column)
    return None if digits is None else printed_like(value, digits) == digits
