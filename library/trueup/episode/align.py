"""Align commands and observations on one clock."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from trueup.episode.layout import Field
from trueup.episode.track import Track
from trueup.errors import NotAnEpisode

Array = NDArray[np.float64]


def align(observed: Track, issued: Track) -> tuple[NDArray[np.int64], Array, Array]:
    """Stamps [ns] `(samples,)`, observations and commands at them, from the first command on.

    Header stamps count if both topics have them, log times otherwise: two clocks would not be one.
    Raises NotAnEpisode.
    """
    for track in (observed, issued):
        track.require_finite()
    issued.require(issued.channels)
    observed.require([c for c in observed.channels if c.field is Field.POSITION])
    by_stamp = observed.has_stamps and issued.has_stamps
    stamps, command_stamps = (
        observed.times_ns(by_stamp=by_stamp),
        issued.times_ns(by_stamp=by_stamp),
    )
    if command_stamps[0] > stamps[-1] or (
        len(command_stamps) > 1 and command_stamps[-1] < stamps[0]
    ):
        raise NotAnEpisode(
            "commands and observations do not overlap in time: are they on one clock?",
            rule="clock",
            topic=issued.topic,
        )
    in_force = np.searchsorted(command_stamps, stamps, side="right") - 1
    first = int(np.argmax(in_force >= 0))
    commands = _over_intervals(stamps[first:], command_stamps, issued.values, in_force[first:])
    return stamps[first:], observed.values[first:], commands


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
