"""Kinematics: how a logged velocity lies against the derivative of the logged position."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueup.doctor.balance import interpolated, weights
from trueup.doctor.tuning import KINEMATICS
from trueup.episode.episode import Episode
from trueup.model.plant import Plant
from trueup.model.series import positions_and_velocities

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Kinematics:
    """dq/dt = slope x (v - offset), `late_s` [s] before the velocity shows it.

    `correlation` is that of the two once the lag is taken out, `at_once` that without a lag; `rows`
    is how many values they rest on.
    """

    slope: float
    offset: float
    late_s: float
    correlation: float
    at_once: float
    rows: int


def kinematics(plant: Plant, episodes: Sequence[Episode], joint: int) -> Kinematics | None:
    """The kinematics of one joint over some episodes; None where no velocity is logged, or where
    nothing moves."""
    pairs = [p for p in (_pair(plant, e, joint) for e in episodes) if p is not None]
    if not pairs:
        return None
    period_s = float(np.median([e.period_s for e in episodes]))
    furthest = max(2, round(KINEMATICS.longest_lag_s / period_s))
    lags = np.unique(np.append(np.arange(-furthest, furthest + 1, max(1, furthest // 60)), 0))
    correlations = np.array([_correlation(pairs, int(lag))[0] for lag in lags])
    if not np.isfinite(correlations).any():
        return None
    sharpest = int(lags[int(np.nanargmax(np.abs(correlations)))])
    nearby = range(sharpest - max(1, furthest // 60), sharpest + max(1, furthest // 60) + 1)
    lag = max(nearby, key=lambda x: np.nan_to_num(abs(_correlation(pairs, x)[0])))
    correlation, rate, velocity = _correlation(pairs, lag)
    if not np.isfinite(correlation) or not np.std(velocity):
        return None
    slope = float(np.sign(correlation) * np.std(rate) / np.std(velocity))
    offset = float(np.mean(velocity) - np.mean(rate) / slope)
    at_once = _correlation(pairs, 0)[0]
    return Kinematics(slope, offset, lag * period_s, float(correlation), at_once, len(rate))


def _pair(plant: Plant, episode: Episode, joint: int) -> tuple[Array, Array] | None:
    """The derivative of the averaged position and the averaged velocity, evenly in time."""
    observed = positions_and_velocities(plant, episode)
    q, v = observed[:, joint], observed[:, len(plant.joints) + joint]
    if np.isfinite(v).sum() < KINEMATICS.fewest or np.isfinite(q).sum() < KINEMATICS.fewest:
        return None
    t = np.arange(0.0, float(episode.t_s[-1]), episode.period_s)
    if len(t) <= KINEMATICS.span:
        return None
    weight, first, _ = weights(KINEMATICS.span, episode.period_s)
    rate = np.convolve(interpolated(t, episode.t_s, q), first, "valid")
    return rate, np.convolve(interpolated(t, episode.t_s, v), weight, "valid")


def _correlation(pairs: Sequence[tuple[Array, Array]], lag: int) -> tuple[float, Array, Array]:
    """Correlation of the rates with velocities that are so many samples late, and both."""
    rates, velocities = [], []
    for rate, velocity in pairs:
        if len(rate) > abs(lag) + 2:
            ends = len(rate) - abs(lag)
            rates.append(rate[max(-lag, 0) :][:ends])
            velocities.append(velocity[max(lag, 0) :][:ends])
    if not rates:
        return float("nan"), np.zeros(0), np.zeros(0)
    x, y = np.concatenate(rates), np.concatenate(velocities)
    spread = float(np.std(x) * np.std(y))
    if spread <= 0.0:
        return float("nan"), x, y
    return float(np.mean((x - x.mean()) * (y - y.mean())) / spread), x, y
