"""A cutoff on single residuals, and an alarm after several in a row beyond it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from trueup.canonical import Json
from trueup.monitor.detector import Detector, FollowedEpisode, Reference, State
from trueup.monitor.residuals import Residuals
from trueup.monitor.tail import Tail

Array = NDArray[np.float64]
RUN = 3


@dataclass(frozen=True)
class QuantileRun(Detector):
    """An alarm after `run` samples in a row whose largest residual of all channels is beyond
    `level`.

    A quantile is a cutoff and not a guarantee: the level is the one that as few healthy blocks pass
    as promised, and behind the largest of them a tail is assumed.
    """

    level: float
    run: int = RUN
    name = "quantile_run"
    rests_on = (
        "a cutoff, no guarantee: blocks to come are drawn like the reference's, and the "
        "tail behind its largest is as assumed"
    )

    @staticmethod
    def calibrate(reference: Reference, rng: np.random.Generator) -> QuantileRun:
        peaks = np.array([_in_a_row(b, RUN).max(initial=0.0) for b in reference.fitted])
        tail = Tail.of(peaks)
        if reference.cautious_rate < tail.share:
            return QuantileRun(float(tail.quantile(reference.cautious_rate)))
        return QuantileRun(float(np.quantile(peaks, 1.0 - reference.cautious_rate)))

    def begin(self) -> State:
        return ()

    def follow(self, state: State, residuals: Residuals) -> FollowedEpisode:
        statistic = np.concatenate(
            [np.zeros(min(self.run - 1, len(residuals.values))), _in_a_row(residuals, self.run)]
        )
        beyond = np.flatnonzero(statistic > self.level)
        if not len(beyond):
            return FollowedEpisode(statistic, None, None, state)
        return FollowedEpisode(
            statistic, int(beyond[0]), int(np.abs(residuals.values[beyond[0]]).argmax()), state
        )

    def labels(self, channels: Sequence[str], signs: Sequence[str]) -> list[str]:
        return [f"{c} is far off" for c in channels]

    def exceedance(self, residuals: Residuals) -> float:
        return float(np.mean(_largest(residuals) > self.level))

    def document(self) -> dict[str, Json]:
        return {"level": self.level, "run": self.run}

    @staticmethod
    def restore(document: Mapping[str, Any]) -> QuantileRun:
        return QuantileRun(float(document["level"]), int(document["run"]))


def _largest(residuals: Residuals) -> Array:
    return np.asarray(np.abs(residuals.values).max(axis=1))


def _in_a_row(residuals: Residuals, run: int) -> Array:
    """The largest level that all of the last `run` samples reach, `(samples - run + 1,)`."""
    largest = _largest(residuals)
    return (
        np.asarray(sliding_window_view(largest, run).min(axis=1))
        if len(largest) >= run
        else np.zeros(0)
    )
