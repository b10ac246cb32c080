"""Measured performance of a detector: false alarms on healthy episodes that it was not calibrated
on, and delays on drifts that were added to them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincinv

from trueup.bootstrap import interval
from trueup.canonical import Json
from trueup.monitor.detector import Detector
from trueup.monitor.residuals import Residuals

Array = NDArray[np.float64]
RESAMPLES = 200
DRIFTS = 40  # drifts of each kind that are put into healthy episodes
EPISODES = 20  # over which a drift grows
LEAST = 1e-300  # of a power, to divide by


def achieved(
    detector: Detector, fresh: Sequence[Residuals], promise_h: float, rng: np.random.Generator
) -> dict[str, Json]:
    """Figures on healthy episodes that the detector was not calibrated on: exceedance and alarms an
    hour with intervals, and delays of drifts.

    An episode counts one alarm at most.
    """
    hours = sum(r.seconds for r in fresh) / 3600.0
    state, alarms = detector.begin(), 0
    for residuals in fresh:
        followed = detector.follow(state, residuals)
        state, alarms = followed.state, alarms + (followed.alarm is not None)
    low, high = poisson_interval(alarms)
    shares = np.array([detector.exceedance(r) for r in fresh])
    ends = interval([shares], np.mean, RESAMPLES, rng)
    return {
        "promised_per_h": 1.0 / promise_h,
        "held_out_h": hours,
        "alarms": alarms,
        "alarms_per_h": alarms / hours,
        "alarms_per_h_ci95": [low / hours, high / hours],
        "exceedance": float(shares.mean()),
        "exceedance_ci95": None if ends is None else list(ends),
        "delays": {
            name: _delay(detector, fresh, drift, rng)
            for name, drift in INJECTED[detector.follows].items()
        },
    }


Drift = Callable[[Residuals, float, float], Residuals]


def _grown(of: Residuals, part: float, luck: float) -> Residuals:
    values = of.values.copy()
    values[:, int(luck * values.shape[1])] *= 1.0 + part
    return replace(of, values=values)


def _shifted(of: Residuals, part: float, luck: float) -> Residuals:
    values = of.values.copy()
    values[:, int(luck * values.shape[1])] += part
    return replace(of, values=values)


def _like_an_effect(of: Residuals, part: float, luck: float) -> Residuals:
    evidence = of.evidence.copy()
    one = evidence[:, int(luck * evidence.shape[1])]
    one[:, 0] += (
        part * np.sqrt(one[:, 1].mean() / np.maximum(one[:, 1].mean() ** 2, LEAST)) * one[:, 1]
    )
    return replace(of, evidence=evidence)


INJECTED: Mapping[str, Mapping[str, Drift]] = {
    "channels": {
        "the spread of a channel doubles": _grown,
        "the mean of a channel moves by its spread": _shifted,
    },
    "signatures": {"an effect moves a channel by its spread": _like_an_effect},
}


def _delay(
    detector: Detector, fresh: Sequence[Residuals], drift: Drift, rng: np.random.Generator
) -> dict[str, Json]:
    """The delay until drifts alarm [s], and the share of drifts that alarm. A drift reaches its
    full size after EPISODES episodes."""
    delays = []
    for _ in range(DRIFTS):
        state, seconds, luck = detector.begin(), 0.0, float(rng.random())
        for i, index in enumerate(rng.integers(0, len(fresh), EPISODES)):
            residuals = drift(fresh[index], (i + 1) / EPISODES, luck)
            followed = detector.follow(state, residuals)
            if followed.alarm is not None:
                delays.append(seconds + float(residuals.t_s[followed.alarm]))
                break
            state, seconds = followed.state, seconds + residuals.seconds
    median = float(np.median(delays + [np.inf] * (DRIFTS - len(delays))))
    return {
        "episodes": EPISODES,
        "found": len(delays) / DRIFTS,
        "median_s": median if np.isfinite(median) else None,
    }


def poisson_interval(count: int, confidence: float = 0.95) -> tuple[float, float]:
    """The exact interval of a Poisson mean after `count` events. Source: F. Garwood, Biometrika 28
    (1936)."""
    tail = (1.0 - confidence) / 2.0
    low = float(gammaincinv(count, tail)) if count else 0.0
    return low, float(gammaincinv(count + 1, 1.0 - tail))
