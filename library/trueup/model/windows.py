"""Windows of an episode: where rollouts start, and the steps between samples."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueup.episode.episode import Episode
from trueup.model.plant import Plant
from trueup.model.state import past_states

Array = NDArray[np.float64]
SAME = 1e-6  # an interval this close to the declared step, relatively, is the declared step
# a start this close before a multiple of the horizon is at it: log stamps are whole nanoseconds
TOUCH_S = 1e-9


@dataclass(frozen=True, slots=True)
class Windows:
    """Rollout windows of one episode, padded to one length.

    `episode` is what they were cut from: a predictor with inner states looks at its past, never
    beyond a window's start. `first` `(windows,)` is each window's first sample, `lengths`
    `(windows,)` its samples. `initial` `(windows, states)`; `issued` `(windows, samples,
    commands)`; `h_s` [s] and `steps` `(windows, samples)`, with 0 steps behind a window's end.
    """

    episode: Episode
    first: NDArray[np.int64]
    lengths: NDArray[np.int64]
    initial: Array
    issued: Array
    h_s: Array
    steps: NDArray[np.int64]

    @property
    def inside(self) -> NDArray[np.bool_]:
        """Which padded samples exist, `(windows, samples)`."""
        return np.arange(self.issued.shape[1]) < self.lengths[:, None]

    @property
    def rows(self) -> NDArray[np.int64]:
        """The episode's sample behind each window's sample, `(windows, samples)`; a padded one
        repeats the last."""
        return self.first[:, None] + np.minimum(
            np.arange(self.issued.shape[1]), self.lengths[:, None] - 1
        )


def starts_every(t_s: Array, horizon_s: float, begin_s: float = 0.0) -> NDArray[np.int64]:
    """The first sample at or after each multiple of the horizon, counted from `begin_s` [s],
    `(windows,)`."""
    # multiples of the horizon passed at each sample
    passed = np.floor((t_s - begin_s + TOUCH_S) / horizon_s)
    return np.flatnonzero(np.diff(np.maximum(passed, -1.0), prepend=-1.0) > 0.0)


def cut(
    plant: Plant,
    episode: Episode,
    first: NDArray[np.int64],
    lengths: NDArray[np.int64] | None = None,
) -> Windows:
    """Windows from each `first` sample to the next one, or of the given lengths, with states from
    the past alone."""
    total = len(episode.t_s)
    lengths = (
        np.diff(np.append(first, total)) if lengths is None else np.minimum(lengths, total - first)
    )
    rows = first[:, None] + np.minimum(np.arange(lengths.max()), lengths[:, None] - 1)
    h_s, steps = intervals(episode.t_s, plant.timestep_s)
    runs = np.arange(lengths.max()) < lengths[:, None] - 1
    return Windows(
        episode,
        first,
        lengths,
        past_states(plant, episode, first),
        plant.over_intervals(episode.commands)[0][rows],
        h_s[rows],
        np.where(runs, steps[rows], 0),
    )


def intervals(t_s: Array, timestep_s: float) -> tuple[Array, NDArray[np.int64]]:
    """Step length [s] and number of steps from each sample to the next, `(samples,)` each; the last
    sample has none."""
    spans = np.diff(t_s)
    steps = np.maximum(1, np.rint(spans / timestep_s)).astype(np.int64)
    h_s = spans / steps
    h_s[np.abs(h_s - timestep_s) < SAME * timestep_s] = timestep_s
    return np.append(h_s, timestep_s), np.append(steps, 0)
