"""Recording: one run as a file of any format holds it, as streams of signals.

Every format is read by an adapter that returns recordings; nothing above an adapter knows the
format. A table (CSV, Parquet, …) is one stream, whose clock is one of its columns or a rate. A log
of messages (MCAP, a ROS bag) has a stream for each topic, whose messages carry their time.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueup.episode.joint_state import Columns
from trueup.episode.layout import Field

TABLE = ""  # the name of a table's stream


@dataclass(frozen=True, slots=True)
class Signal:
    """One number over time. `name` is unique within its stream. `joint` and `field` are what the
    message itself says of it, None where only the name may tell."""

    name: str
    joint: str | None = None
    field: Field | None = None


@dataclass(frozen=True, slots=True)
class Stream:
    """Signals that share their times: a topic, or a table. `kind` is the type of its messages, or
    `table`; `is_clocked` says whether its rows carry their time."""

    name: str
    kind: str
    signals: tuple[Signal, ...]
    is_clocked: bool

    def signal(self, name: str) -> Signal | None:
        """The signal of this name, None where there is none."""
        return next((s for s in self.signals if s.name == name), None)


@dataclass(frozen=True, slots=True)
class Clock:
    """How the rows of a table get their time: by the column `signal` in `unit`, or by a rate [Hz].
    A column of dates needs no unit."""

    signal: str | None = None
    unit: str = "s"
    rate_hz: float | None = None


@dataclass(frozen=True, slots=True)
class Span:
    """The times of a stream's first and last row [ns], and how many rows it has."""

    first_ns: int
    last_ns: int
    rows: int

    def with_times(self, times: Sequence[int] | NDArray[np.int64]) -> Span:
        """The span with further rows at these times."""
        if not len(times):
            return self
        first, last = int(np.min(times)), int(np.max(times))
        return Span(min(self.first_ns, first), max(self.last_ns, last), self.rows + len(times))


Wanted = Mapping[str, Sequence[str]]  # of each stream the signals to read, by name


class Recording(ABC):
    """One run.

    `name` tells it from others of its file; `format` is the adapter's name.
    """

    name: str
    format: str

    @property
    @abstractmethod
    def role(self) -> str | None:
        """The role that it declares, None where it declares none."""

    @property
    @abstractmethod
    def streams(self) -> tuple[Stream, ...]:
        """Its streams, with the signals that their first rows show. Raises BadEpisode."""

    @abstractmethod
    def span(self, stream: str, clock: Clock | None) -> Span:
        """From when to when a stream goes. Raises BadEpisode."""

    @abstractmethod
    def read(self, wanted: Wanted, clock: Clock | None) -> Iterator[tuple[str, Columns]]:
        """The rows of the wanted streams block by block, in one pass and bounded memory: the name
        of a stream, and columns `(rows, wanted signals of it)` with their times. A signal that a
        row lacks is nan. Raises BadEpisode."""

    def stream(self, name: str) -> Stream | None:
        """The stream of this name, None where there is none."""
        return next((s for s in self.streams if s.name == name), None)
