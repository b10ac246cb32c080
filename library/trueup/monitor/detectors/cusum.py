"""Cumulative sums: small residuals add up to an alarm.

Source: E. S. Page, Biometrika 41 (1954); the likelihood ratio's optimality: G. Lorden, Annals of
Mathematical Statistics 42 (1971). Both hold for independent residuals, which these are not: the
level is set on resampled blocks of healthy ones.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from trueup.canonical import Json
from trueup.monitor.detector import Detector, FollowedEpisode, Reference, State
from trueup.monitor.futures import add_block
from trueup.monitor.residuals import Residuals
from trueup.monitor.tail import Tail

Array = NDArray[np.float64]
LARGEST = 8.0  # healthy spreads that one residual counts at most: a single wild sample is no change
SHIFT = 1.0  # of the mean, in healthy spreads, for which the tabular sum is the best
GROWTH = 1.5  # of the spread, for which the likelihood ratio is the best: less than twice
# of one channel's healthy power: the error has grown by a fifth where two are observed
NOTICED = 0.5
LEAST_POWER = 1e-12  # of a signature: the data show nothing of it
# standard errors of what the reference tells of a signature: smaller effects are not looked for
SURE = 3.0
# that any sum of signatures may rise in a healthy block: what few windows show must not set the
# level for all
CALM = 4.0
MOST = 20.0  # that one window adds at most
STREAMS, LENGTH = 256, 3000  # resampled futures, and blocks in each
LEVELS = 16
LEAST_ALARMS = 40  # in all futures together, for a rate to be read off
C = TypeVar("C", bound="Cusum")


@dataclass(frozen=True)
class Cusum(Detector):
    """Base of detectors whose statistic is the largest of several sums, each at least 0, of the
    evidence for one change."""

    level: float
    rests_on = (
        "calibrated, no guarantee: blocks to come are drawn like the reference's, whatever "
        "the dependence within one"
    )

    @abstractmethod
    def increments(self, residuals: Residuals) -> Array:
        """The increment of each sum at each step, a sample or a window, `(steps, sums)`: negative
        on the mean for healthy residuals."""

    @abstractmethod
    def sums(self) -> int:
        """The number of sums."""

    @staticmethod
    def ends(residuals: Residuals) -> NDArray[np.int64]:
        """The sample at which each step ends, `(steps,)`."""
        return np.arange(len(residuals.values))

    def begin(self) -> State:
        return (0.0,) * self.sums()

    def follow(self, state: State, residuals: Residuals) -> FollowedEpisode:
        sums = np.cumsum(self.increments(residuals), axis=0)
        path = sums - np.minimum(np.minimum.accumulate(sums, axis=0), -np.array(state))
        highest, ends = path.max(axis=1), self.ends(residuals)
        held = np.searchsorted(ends, np.arange(len(residuals.values)), side="right")
        statistic = np.append(max(state, default=0.0), highest)[held]
        beyond = np.flatnonzero(highest > self.level)
        if len(beyond):
            at = int(beyond[0])
            return FollowedEpisode(statistic, int(ends[at]), int(path[at].argmax()), self.begin())
        return FollowedEpisode(
            statistic, None, None, tuple(float(x) for x in path[-1]) if len(path) else state
        )

    def exceedance(self, residuals: Residuals) -> float:
        return float(np.mean(self.follow(self.begin(), residuals).statistic > self.level))


@dataclass(frozen=True)
class TabularCusum(Cusum):
    """Two sums for each channel, for a mean that rises and for one that falls: S = max(0, S +- (z -
    centre) - SHIFT / 2)."""

    centre: tuple[float, ...]
    name = "tabular_cusum"

    def increments(self, residuals: Residuals) -> Array:
        moved = _clipped(residuals) - np.array(self.centre)
        return np.asarray((np.hstack([moved, -moved]) - SHIFT / 2.0) * residuals.weight[:, None])

    def sums(self) -> int:
        return 2 * len(self.centre)

    def labels(self, channels: Sequence[str], signs: Sequence[str]) -> list[str]:
        return [f"{c} falls behind" for c in channels] + [f"{c} runs ahead" for c in channels]

    @staticmethod
    def calibrate(reference: Reference, rng: np.random.Generator) -> TabularCusum:
        means = [b.weight @ _clipped(b) / b.weight.sum() for b in reference.fitted]
        return calibrated(
            TabularCusum(0.0, tuple(float(x) for x in np.mean(means, axis=0))), reference, rng
        )

    def document(self) -> dict[str, Json]:
        return {"level": self.level, "centre": list(self.centre)}

    @staticmethod
    def restore(document: Mapping[str, Any]) -> TabularCusum:
        return TabularCusum(float(document["level"]), tuple(float(x) for x in document["centre"]))


@dataclass(frozen=True)
class LikelihoodRatioCusum(Cusum):
    """One sum for each channel, of the log likelihood ratio of a spread GROWTH times as large:
    z^2/2 (1 - 1/GROWTH^2) - ln GROWTH."""

    channels: int
    name = "likelihood_ratio_cusum"

    def increments(self, residuals: Residuals) -> Array:
        ratio = _clipped(residuals) ** 2 * (1.0 - GROWTH**-2) / 2.0 - np.log(GROWTH)
        return np.asarray(ratio * residuals.weight[:, None])

    def sums(self) -> int:
        return self.channels

    def labels(self, channels: Sequence[str], signs: Sequence[str]) -> list[str]:
        return [f"{c} is predicted worse" for c in channels]

    @staticmethod
    def calibrate(reference: Reference, rng: np.random.Generator) -> LikelihoodRatioCusum:
        return calibrated(
            LikelihoodRatioCusum(0.0, reference.fitted[0].values.shape[1]), reference, rng
        )

    def document(self) -> dict[str, Json]:
        return {"level": self.level, "channels": self.channels}

    @staticmethod
    def restore(document: Mapping[str, Any]) -> LikelihoodRatioCusum:
        return LikelihoodRatioCusum(float(document["level"]), int(document["channels"]))


def _clipped(residuals: Residuals) -> Array:
    return np.clip(residuals.values, -LARGEST, LARGEST)


@dataclass(frozen=True)
class EffectCusum(Cusum):
    """Two sums of each signature, of the log likelihood ratio of residuals with that effect in them
    and without, one for each sign.

    The effect is as large as moves one channel by half of its healthy power, `amplitude` of its
    signature, beyond what a served model that is not perfect has of it, `healthy`, and larger than
    what the reference leaves open of that; `inflation` is how much more a sum of correlated
    residuals varies. All `(signatures,)`.
    """

    amplitude: tuple[float, ...]
    inflation: tuple[float, ...]
    healthy: tuple[float, ...]
    name = "effect_cusum"
    follows = "signatures"

    def increments(self, residuals: Residuals) -> Array:
        common, power = np.moveaxis(residuals.evidence, 2, 0)
        size, divisor = np.array(self.amplitude), np.array(self.inflation)
        expected = size**2 * power / 2.0
        common = common - np.array(self.healthy) * power
        return np.asarray(
            np.clip(
                np.hstack(
                    [(size * common - expected) / divisor, (-size * common - expected) / divisor]
                ),
                -MOST,
                MOST,
            )
        )

    def sums(self) -> int:
        return 2 * len(self.amplitude)

    @staticmethod
    def ends(residuals: Residuals) -> NDArray[np.int64]:
        return np.flatnonzero(np.diff(residuals.window, append=residuals.windows))

    def labels(self, channels: Sequence[str], signs: Sequence[str]) -> list[str]:
        return [f"like more {s}" for s in signs] + [f"like less {s}" for s in signs]

    @staticmethod
    def calibrate(reference: Reference, rng: np.random.Generator) -> EffectCusum:
        # of each block
        common, power = np.moveaxis(
            np.array([b.evidence.sum(axis=0) for b in reference.fitted]), 2, 0
        )
        mean = np.maximum(power.mean(axis=0), LEAST_POWER)
        healthy = common.mean(axis=0) / mean
        varies = ((common - healthy * power) ** 2).mean(axis=0)
        open_to = np.sqrt(varies / len(common)) / mean
        noticed = np.sqrt(NOTICED * reference.windows / mean)
        amplitude = np.where(
            power.mean(axis=0) > LEAST_POWER, np.maximum(noticed, 2.0 * SURE * open_to), 0.0
        )
        plain = EffectCusum(
            0.0,
            _floats(amplitude),
            _floats(np.maximum(varies / mean, LEAST_POWER)),
            _floats(healthy),
        )
        rise = _summary(plain, reference.fitted).rise.max(axis=0).reshape(2, -1).max(axis=0)
        calm = replace(
            plain, inflation=_floats(np.array(plain.inflation) * np.maximum(rise / CALM, 1.0))
        )
        return calibrated(calm, reference, rng)

    def document(self) -> dict[str, Json]:
        return {
            "level": self.level,
            "amplitude": list(self.amplitude),
            "inflation": list(self.inflation),
            "healthy": list(self.healthy),
        }

    @staticmethod
    def restore(document: Mapping[str, Any]) -> EffectCusum:
        numbers = (
            tuple(float(x) for x in document[name])
            for name in ("amplitude", "inflation", "healthy")
        )
        return EffectCusum(float(document["level"]), *numbers)


def _floats(values: Array) -> tuple[float, ...]:
    return tuple(float(x) for x in values)


@dataclass(frozen=True)
class _Summary:
    """All that a sum needs of each block `(blocks, sums)`: total, highest and lowest partial sum,
    and the highest rise within it."""

    total: Array
    high: Array
    low: Array
    rise: Array

    @cached_property
    def highest(self) -> Array:
        """The highest rise of any sum within each block, `(blocks,)`."""
        return np.asarray(self.rise.max(axis=1))

    @cached_property
    def tail(self) -> Tail:
        """The tail of the blocks' highest rises."""
        return Tail.of(self.highest)

    def drawn(self, index: NDArray[np.int64], rng: np.random.Generator) -> _Summary:
        """Blocks by their index `(n,)`; those with the highest rises are made as high as their tail
        is."""
        rise, drawn = self.highest[index], self.tail.draw(len(index), rng)
        behind = np.flatnonzero(rise > self.tail.threshold)
        grown = (drawn[behind] / rise[behind])[:, None]
        parts = []
        for of_blocks in (self.total, self.high, self.low, self.rise):
            part = of_blocks[index]
            raised = part[behind]
            part[behind] = np.where(raised > 0.0, raised * grown, raised)
            parts.append(part)
        return _Summary(*parts)


def _summary(detector: Cusum, blocks: Sequence[Residuals]) -> _Summary:
    rows = []
    for block in blocks:
        sums = np.cumsum(detector.increments(block), axis=0)
        rise = (sums - np.minimum(np.minimum.accumulate(sums, axis=0), 0.0)).max(axis=0)
        rows.append(np.stack([sums[-1], sums.max(axis=0), np.minimum(sums.min(axis=0), 0.0), rise]))
    return _Summary(*np.moveaxis(np.array(rows), 1, 0))


def calibrated(detector: C, reference: Reference, rng: np.random.Generator) -> C:
    """The detector with the level that resampled futures pass as rarely as promised.

    Each future draws its blocks from a resampled reference, so that the uncertainty of a short
    reference is part of the rate, and its largest blocks from a tail. Rates too small to be counted
    are extrapolated along the line through the logarithms of those that are: a sum that falls on
    the mean has an exponential tail.
    """
    of = _summary(detector, reference.fitted)
    levels = _passed_once(of, rng)
    alarms = np.zeros(LEVELS)
    n, sums = of.rise.shape
    streams = rng.integers(0, n, (STREAMS, n))
    state = np.zeros((LEVELS, sums, STREAMS))
    for _ in range(LENGTH):
        block = of.drawn(streams[np.arange(STREAMS), rng.integers(0, n, STREAMS)], rng)
        parts = (block.total, block.high, block.low, block.rise)
        add_block(state, *(np.ascontiguousarray(part.T) for part in parts), levels, alarms)
    rates = alarms / (STREAMS * LENGTH)
    counted = alarms >= LEAST_ALARMS
    if rates[counted].min() < reference.cautious_rate:
        level = float(
            np.interp(
                np.log(reference.cautious_rate), np.log(rates[counted])[::-1], levels[counted][::-1]
            )
        )
        return replace(detector, level=level)
    tail = np.flatnonzero(counted)[-LEVELS // 2 :]
    slope, at = np.polyfit(levels[tail], np.log(rates[tail]), 1)
    return replace(detector, level=float((np.log(reference.cautious_rate) - at) / slope))


def _passed_once(of: _Summary, rng: np.random.Generator) -> Array:
    """Levels `(LEVELS,)`, from what one block reaches by itself to what hardly any future
    passes."""
    state, highest = np.zeros((STREAMS, of.total.shape[1])), np.zeros(STREAMS)
    for _ in range(LENGTH):
        block = of.drawn(rng.integers(0, len(of.rise), STREAMS), rng)
        highest = np.maximum(highest, np.maximum(state + block.high, block.rise).max(axis=1))
        state = np.maximum(state + block.total, block.total - block.low)
    return np.linspace(
        float(np.median(of.rise.max(axis=1))), float(np.quantile(highest, 0.9)), LEVELS
    )
