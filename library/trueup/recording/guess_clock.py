"""Guess the clock of a table: which column is the time, and in which unit."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from trueup.episode.units import TIMES
from trueup.errors import BadMapping
from trueup.recording.quantity import Quantity
from trueup.recording.recording import Clock, Recording
from trueup.recording.table import TableRecording

EPOCH = ((1e17, "ns"), (1e14, "us"), (1e11, "ms"))  # what counts from 1970 is at least so large
SLOWEST_S = 1.0  # between samples of a controlled joint: a longer step is in a smaller unit
MOST_RISE = 0.5  # of a column of times more steps than this do not go back


def clock_of(
    recording: TableRecording, quantities: Sequence[Quantity], asked: Clock | None
) -> tuple[Clock, bool]:
    """The clock of a table, and whether it is a guess: what was asked for, what the format tells,
    or the column that is called a time. Raises BadMapping where there is none."""
    if asked is not None and (asked.rate_hz is not None or (asked.signal and asked.unit)):
        return asked, False
    if asked is None and recording.suggested is not None:
        return recording.suggested, False
    head = recording.head()
    if asked is not None and asked.signal is not None:
        times = [q for q in quantities if q.signal.name == asked.signal]
    else:
        times = [q for q in quantities if q.is_time and _increases(head.get(q.signal.name))]
    likely = best(times, lambda q: q.unit in TIMES)
    if not likely:
        named = asked.signal if asked is not None else None
        what = "no column looks like the time" if named is None else f"no {named!r} is there"
        raise BadMapping(
            f"{recording.name}: {what}",
            field="time",
            hint="Name the column with --time, or give the rate with --rate. "
            f"{signals_in_words(recording)}",
        )
    chosen, is_one = likely[0], len(likely) == 1
    if asked is not None and asked.unit:
        return Clock(chosen.signal.name, asked.unit), not is_one
    if chosen.unit is not None and chosen.unit in TIMES:
        return Clock(chosen.signal.name, chosen.unit), not is_one
    unit, is_certain = _unit(head.get(chosen.signal.name))
    return Clock(chosen.signal.name, unit), not (is_one and is_certain)


def _increases(values: Any) -> bool:
    if values is None or len(values) < 2 or values.dtype.kind == "M":  # noqa: PLR2004  (a step needs two)
        return True
    steps = np.diff(np.asarray(values, float))
    return bool((steps >= 0.0).mean() > MOST_RISE and steps.any())


def _unit(values: Any) -> tuple[str, bool]:
    """The unit of a column of times that names none, and whether it is certain."""
    if values is None or not len(values) or values.dtype.kind == "M":
        return "s", True
    times = np.asarray(values, float)
    for least, unit in EPOCH:
        if abs(times[0]) >= least:
            return unit, True
    step = float(np.nanmedian(np.abs(np.diff(times)))) if len(times) > 1 else 0.0
    for unit, size in TIMES.items():
        if step * size < SLOWEST_S:
            return unit, unit == "s"
    return "ns", False


def best(among: Sequence[Quantity], key: Callable[[Quantity], Any]) -> list[Quantity]:
    """Those of the largest key."""
    keys = [key(q) for q in among]
    return [q for q, k in zip(among, keys, strict=True) if k == max(keys)]


MOST_LISTED = 40


def signals_in_words(recording: Recording) -> str:
    """Every signal of a recording, for a person to choose from."""
    parts = []
    for stream in recording.streams:
        names = [s.name for s in stream.signals]
        more = f" and {len(names) - MOST_LISTED} more" if len(names) > MOST_LISTED else ""
        listed = ", ".join(names[:MOST_LISTED]) + more
        parts.append(f"{stream.name} ({stream.kind}): {listed}" if stream.name else listed)
    return f"There is {'; '.join(parts) or 'no signal'}."
