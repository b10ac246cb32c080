"""Tables: a recording whose rows share one clock, from columns in memory or in a file.

Rules of a table, each named in the NotAnEpisode that it raises:
- columns: it has columns of numbers, each name stands once, and all are equally long;
- clock: its time is a column that is named, in a unit that is known, or a rate;
- number: what stands in a column of numbers is a number, or missing.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trueup.episode.joint_state import Columns
from trueup.episode.units import TIMES, spelled
from trueup.errors import NotAnEpisode
from trueup.recording.recording import TABLE, Clock, Recording, Signal, Span, Stream, Wanted

Array = NDArray[Any]
# The columns of these names, block by block: each `(rows,)`, of numbers, truth values or dates
Blocks = Callable[[Sequence[str]], Iterator[Mapping[str, Array]]]
NS_PER_S = 1_000_000_000
LARGEST_NS = 2.0**62
KINDS = "bifuMm"  # of numpy's types: truth values, numbers, dates, spans of time


class TableRecording(Recording):
    """A recording of one table with these columns, which `blocks` reads. `suggested` is its clock
    and `angles` the unit of its angles, where its format tells them."""

    def __init__(
        self,
        name: str,
        format_: str,
        columns: Sequence[str],
        blocks: Blocks,
        suggested: Clock | None = None,
        angles: str | None = None,
    ) -> None:
        self.name, self.format = name, format_
        self._columns, self._blocks = tuple(columns), blocks
        self.suggested, self.angles = suggested, angles

    @property
    def role(self) -> str | None:
        return None

    @cached_property
    def streams(self) -> tuple[Stream, ...]:
        if not self._columns:
            raise NotAnEpisode(f"{self.name} has no column of numbers", rule="columns", hint=HINT)
        twice = next((c for c in self._columns if self._columns.count(c) > 1), None)
        if twice is not None:
            raise NotAnEpisode(
                f"two columns of {self.name} are named {twice!r}", rule="columns", column=twice
            )
        return (Stream(TABLE, "table", tuple(Signal(c) for c in self._columns), False),)

    def span(self, stream: str, clock: Clock | None) -> Span:
        whole: Span | None = None
        for _, columns in self.read({stream: ()}, clock):
            if len(columns.log_ns):
                first = int(columns.log_ns[0])
                whole = (whole or Span(first, first, 0)).with_times(columns.log_ns)
        if whole is None:
            raise NotAnEpisode(f"{self.name} has no rows", rule="samples")
        return whole

    def read(self, wanted: Wanted, clock: Clock | None) -> Iterator[tuple[str, Columns]]:
        clock = clock or self.suggested
        if clock is None or (clock.signal is None) == (clock.rate_hz is None):
            raise NotAnEpisode(
                f"nothing says when the rows of {self.name} were recorded",
                rule="clock",
                hint="Name the column of time with --time, or give the rate with --rate.",
            )
        signals = list(wanted.get(TABLE, ()))
        names = list(dict.fromkeys([*signals, *([clock.signal] if clock.signal else [])]))
        unknown = [n for n in names if n not in self._columns]
        if unknown:
            raise NotAnEpisode(
                f"{self.name} has no column {unknown[0]!r}; its columns are: "
                f"{', '.join(self._columns)}",
                rule="columns",
                column=unknown[0],
            )
        rows = 0
        for block in self._blocks(names or self._columns[:1]):
            count = len(next(iter(block.values())))
            if clock.signal is not None:
                times = times_ns(block[clock.signal], clock.unit, clock.signal, rows)
            else:
                assert clock.rate_hz is not None
                at = np.arange(rows, rows + count)
                times = np.rint(at * (NS_PER_S / clock.rate_hz)).astype(np.int64)
            values = np.empty((count, len(signals)))
            for column, name in enumerate(signals):
                values[:, column] = _numbers(block[name], name)
            rows += count
            yield TABLE, Columns(times, times, values)

    def head(self) -> Mapping[str, Array]:
        """The first block of every column."""
        return next(self._blocks(self._columns), {})


HINT = "A table needs a column of time, one of positions and one of commands, each with a header."


def times_ns(values: Array, unit: str, name: str, row: int) -> NDArray[np.int64]:
    """A column of time as nanoseconds `(rows,)`; `row` is the first one's number. Raises
    NotAnEpisode."""
    if values.dtype.kind in "Mm":
        dates = values.astype(f"{values.dtype.kind}8[ns]")
        missing = np.isnat(dates)
        times = dates.astype(np.int64)
    else:
        size = TIMES.get(spelled(unit))
        if size is None:
            raise NotAnEpisode(
                f"{unit!r} is no unit of time", rule="clock", hint=f"Give {', '.join(TIMES)}."
            )
        per_unit = round(NS_PER_S * size)
        if values.dtype.kind in "iu" and np.abs(values).max(initial=0) < LARGEST_NS / per_unit:
            return values.astype(np.int64) * per_unit
        exact = np.asarray(values, np.float64) * per_unit
        missing = ~(np.abs(exact) < LARGEST_NS)
        times = np.rint(np.where(missing, 0.0, exact)).astype(np.int64)
    if missing.any():
        at = row + int(np.argmax(missing))
        raise NotAnEpisode(
            f"row {at} has no time in the column {name!r}", rule="clock", column=name, index=at
        )
    return times


def _numbers(values: Array, name: str) -> NDArray[np.float64]:
    if values.ndim != 1 or values.dtype.kind not in "biuf":
        raise NotAnEpisode(f"the column {name!r} does not hold numbers", rule="number", column=name)
    return np.asarray(values, np.float64)
