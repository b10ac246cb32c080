"""Stack: the series of several episodes one after another, as compiled rollouts take them, so that
all episodes cost one call."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from itertools import pairwise
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

from trueup.episode.episode import Episode
from trueup.model.plant import Plant
from trueup.model.series import Samples, Scheme, Series, seen_by, series

Array = NDArray[np.float64]
# of a rollout, in numbers (8 MB): parts that are larger leave the processor's caches
PART = 1 << 20


@dataclass(frozen=True, slots=True)
class Part:
    """Some episodes of a stack, `first` to `end`, with their samples and their windows."""

    first: int
    end: int
    samples: slice
    windows: slice


@dataclass(frozen=True, eq=False)
class Stack(Samples, Sequence[Series]):
    """Series of one scheme, one after another, and the sequence of them.

    `window_of` and `resets` count the windows of all episodes. `ends` and `window_ends`
    `(episodes + 1,)` are the first sample and the first window of each episode, and behind them how
    many there are; `periods_s` `(episodes,)` the episodes' periods.
    """

    series: tuple[Series, ...]
    ends: NDArray[np.int64]
    window_ends: NDArray[np.int64]
    periods_s: Array

    @staticmethod
    def of(some: Sequence[Series]) -> Stack:
        """The stack of some series, which may be one. Raises ValueError where their schemes
        differ."""
        if isinstance(some, Stack):
            return some
        if len({s.scheme for s in some}) != 1:
            raise ValueError("a stack has series of one scheme")
        ends = np.cumsum([0, *(len(s.t_s) for s in some)])
        window_ends = np.cumsum([0, *(len(s.begin) for s in some)])

        before = np.repeat(window_ends[:-1], np.diff(ends))
        arrays: dict[str, NDArray[Any]] = {
            f.name: np.concatenate([getattr(s, f.name) for s in some]) for f in fields(Samples)
        }
        for name in ("window_of", "resets"):
            arrays[name] = np.where(arrays[name] >= 0, arrays[name] + before, -1)
        periods_s = np.array([s.period_s for s in some])
        return Stack(
            **arrays,
            series=tuple(some),
            ends=ends,
            window_ends=window_ends,
            periods_s=periods_s,
        )

    @staticmethod
    def cut(
        plant: Plant, episodes: Sequence[Episode], scheme: Scheme, window_s: float, merged: int = 1
    ) -> Stack:
        """Episodes cut into windows as by `series`, as a stack."""
        return Stack.of([series(plant, e, scheme, window_s, merged=merged) for e in episodes])

    def __len__(self) -> int:
        return len(self.series)

    @overload
    def __getitem__(self, which: int) -> Series: ...

    @overload
    def __getitem__(self, which: slice) -> Sequence[Series]: ...

    def __getitem__(self, which: int | slice) -> Series | Sequence[Series]:
        return self.series[which]

    @property
    def scheme(self) -> Scheme:
        """How all of them are integrated."""
        return self.series[0].scheme

    @cached_property
    def digests(self) -> tuple[str, ...]:
        """The episodes' digests, in order."""
        return tuple(s.digest for s in self.series)

    @cached_property
    def usable_in_windows(self) -> NDArray[np.int64]:
        """How many samples of each position and velocity are compared, `(2 x joints,)`."""
        return np.asarray((self.usable & (self.window_of >= 0)[:, None]).sum(axis=0))

    @cached_property
    def periods_of_windows(self) -> Array:
        """The period of each window's samples [s], `(windows,)`."""
        return self.periods_s[self.episode_of]

    @cached_property
    def episode_of(self) -> NDArray[np.int64]:
        """The episode of each window, `(windows,)`."""
        return np.repeat(np.arange(len(self.series)), np.diff(self.window_ends))

    def split(self, of_windows: NDArray[Any]) -> list[NDArray[Any]]:
        """Something of every window `(windows, …)`, episode by episode."""
        return [of_windows[a:b] for a, b in pairwise(self.window_ends.tolist())]

    def parts(self, numbers: int, *, alone: bool = False) -> Iterator[Part]:
        """The episodes in parts whose rollouts, of so many numbers a sample, stay small; or each
        `alone`."""
        ends, windows = self.ends.tolist(), self.window_ends.tolist()
        first = 0
        for end in range(1, len(ends)):
            full = end + 1 == len(ends) or (ends[end + 1] - ends[first]) * numbers > PART
            if alone or full:
                yield Part(
                    first,
                    end,
                    slice(ends[first], ends[end]),
                    slice(windows[first], windows[end]),
                )
                first = end

    def seen(self, late_s: Array) -> tuple[NDArray[np.int64], Array]:
        """The window whose motion each sample shows, -1 where none, and how much each counts, 0
        where it is not usable, `(samples, 2 x joints)` each, where joints are seen `late_s`
        `(joints,)`."""
        if not late_s.any():
            return self._seen_at_once
        windows, weights = zip(*(seen_by(s, late_s) for s in self.series), strict=True)
        before = np.repeat(self.window_ends[:-1], np.diff(self.ends))[:, None]
        window_of = np.concatenate(windows)
        counts = np.concatenate(weights) * self.usable
        return np.where(window_of >= 0, window_of + before, -1), counts

    @cached_property
    def _seen_at_once(self) -> tuple[NDArray[np.int64], Array]:
        window_of = np.repeat(self.window_of[:, None], self.observed.shape[1], axis=1)
        return window_of, self.usable.astype(np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class RolloutOf:
    """What is asked of a stack: each episode's block's parameters `(episodes, rows, lanes)`; where
    windows start `(windows, 2 x joints, lanes)`, or filters `(episodes, 2 x joints, lanes)`; the
    `gains` `(beginning, joints, 4, 2, filters)` of filters in the first lanes, each followed by the
    lane FILTERS behind it; and how many lanes behind the first differ from it in what windows start
    from alone, and begin each window with its hidden states."""

    stack: Stack
    p: Array
    init: Array
    gains: Array | None = None
    starts: int = 0
