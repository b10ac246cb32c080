"""Align commands and observations on one clock."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueup.episode.layout import Field, Hold
from trueup.episode.omission import Omission, TopicOffset
from trueup.episode.track import Track
from trueup.errors import NotAnEpisode

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Aligned:
    """Stamps [ns] `(samples,)`, observations, issued commands and, where they were recorded,
    applied ones and efforts at them; what was left out, and how the two topics lie against each
    other."""

    stamps: NDArray[np.int64]
    observations: Array
    commands: Array
    applied: Array | None
    effort: Array | None
    omissions: tuple[Omission, ...]
    offset: TopicOffset


def align(
    observed: Track,
    issued: Track,
    applied: Track | None = None,
    effort: Array | None = None,
    late_ns: int = 0,
) -> Aligned:
    """Everything at the stamps of the observations, from the first command on. `effort` `(messages,
    command channels)` came with the observations; a channel without any is none.

    Header stamps count if every topic has them, log times otherwise: two clocks would not be one.
    Observations happened `late_ns` [ns] before their stamps. Raises NotAnEpisode.
    """
    tracks = (observed, issued) if applied is None else (observed, issued, applied)
    issued.require(issued.channels)
    observed.require([c for c in observed.channels if c.field is Field.POSITION])
    by_stamp = all(track.has_stamps for track in tracks)
    kept = [track.kept(by_stamp=by_stamp) for track in tracks]
    if effort is not None:
        effort = effort[observed.says_something(by_stamp=by_stamp)]
    observed, issued = kept[0][0], kept[1][0]
    applied = None if applied is None else kept[2][0]
    stamps = observed.times_ns(by_stamp=by_stamp) - late_ns
    command_stamps = issued.times_ns(by_stamp=by_stamp)
    if command_stamps[0] > stamps[-1] or (
        len(command_stamps) > 1 and command_stamps[-1] < stamps[0]
    ):
        raise NotAnEpisode(
            "commands and observations do not overlap in time: are they on one clock?",
            rule="clock",
            topic=issued.topic,
        )
    offset = _offset(observed, issued, by_stamp=by_stamp)
    in_force = np.searchsorted(command_stamps, stamps, side="right") - 1
    first = int(np.argmax(in_force >= 0))
    commands = _over_intervals(stamps[first:], command_stamps, issued.values, in_force[first:])
    stamps = stamps[first:]
    for column, channel in enumerate(issued.channels):
        if channel.hold is Hold.FIRST_ORDER:  # a ramp has a value of its own at each sample
            apart = (command_stamps - stamps[0]).astype(np.float64)
            commands[:, column] = np.interp(stamps - stamps[0], apart, issued.values[:, column])
    return Aligned(
        stamps,
        observed.values[first:],
        commands,
        None if applied is None else _applied(stamps, applied, by_stamp=by_stamp),
        None if effort is None or np.isnan(effort).all() else effort[first:],
        tuple(o for _, omissions in kept for o in omissions),
        offset,
    )


def _offset(observed: Track, issued: Track, *, by_stamp: bool) -> TopicOffset:
    """How the topics lie against each other."""
    stamps, command_stamps = (t.times_ns(by_stamp=by_stamp) for t in (observed, issued))
    latencies = [float(np.median(t.log_ns - t.stamp_ns)) / 1e9 for t in (observed, issued)]
    return TopicOffset(
        int(stamps[0] - command_stamps[0]) / 1e9,
        int(stamps[-1] - command_stamps[-1]) / 1e9,
        len(stamps),
        len(command_stamps),
        (latencies[0], latencies[1]) if by_stamp else None,
    )


def _applied(stamps: NDArray[np.int64], track: Track, *, by_stamp: bool) -> Array:
    """Applied commands over each interval between samples; nan before the first message."""
    times = track.times_ns(by_stamp=by_stamp)
    in_force = np.searchsorted(times, stamps, side="right") - 1
    known = in_force >= 0
    values = np.full((len(stamps), len(track.channels)), np.nan)
    if known.any():
        values[known] = _over_intervals(stamps[known], times, track.values, in_force[known])
    return values


def _over_intervals(
    stamps: NDArray[np.int64],
    command_stamps: NDArray[np.int64],
    values: Array,
    in_force: NDArray[np.int64],
) -> Array:
    """The command over each interval between samples: the one in force, or the mean of those in
    force where it changes within.

    A command that changes strictly between two samples acts for a part of the interval only; taking
    the one that was in force at its beginning would shift commands against observations and bias
    every fit.
    """
    commands = values[in_force]
    # the one in force just before the next sample
    last = np.searchsorted(command_stamps, stamps[1:], side="left") - 1
    for i in np.flatnonzero(last > in_force[:-1]):
        within = np.concatenate(
            [
                stamps[i : i + 1],
                command_stamps[in_force[i] + 1 : last[i] + 1],
                stamps[i + 1 : i + 2],
            ]
        )
        spans = np.diff(within).astype(np.float64)
        commands[i] = spans @ values[in_force[i] : last[i] + 1] / spans.sum()
    return commands
