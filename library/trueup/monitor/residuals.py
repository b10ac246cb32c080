"""Residuals of a predictor on an episode: observed less predicted, in units of the healthy spread.

Rollouts start at each multiple of the horizon, and anew with each episode. A sample's residual is
divided by the root mean square that healthy episodes show in its channel at its age, the time since
its rollout started: so a sample a moment after a start and one at the end of a window count alike.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trueup.canonical import Json
from trueup.episode.episode import Episode
from trueup.model.predictor import Predictor, predict_observations
from trueup.model.state import known_from
from trueup.model.windows import cut, starts_every

Array = NDArray[np.float64]
AGES = 8  # parts of the horizon that have a healthy spread of their own
RAN_AWAY = 1e6  # times the healthy spread: no residual is larger
TOUCH = 1e-9  # of the horizon: an age that rounding put at a bound


def one_step_residuals(predictor: Predictor, states: Array, issued: Array) -> Array:
    """Norm over channels of (observed - predicted next observation) / declared scale, `(samples -
    1,)`, of one episode."""
    plant = predictor.plant
    missed = plant.observe(states[1:]) - plant.observe(predictor.predict_batch(states[:-1], issued))
    return np.asarray(np.linalg.norm(missed / plant.scales, axis=1))


@dataclass(frozen=True, slots=True, eq=False)
class UnscaledResiduals:
    """Unscaled residuals of one episode, in declared units: `values` `(samples, channels)` at `t_s`
    [s] of the episode.

    `rows` `(samples,)` are these samples in the episode, `age` the time since the sample's rollout
    started, in horizons, `window` its number; samples at which a rollout starts, `first`
    `(windows,)`, are left out. `seconds` [s] is the robot time of the episode.
    """

    values: Array
    t_s: Array
    rows: NDArray[np.int64]
    first: NDArray[np.int64]
    age: Array
    window: NDArray[np.int64]
    seconds: float


def unscaled_residuals(predictor: Predictor, episode: Episode) -> UnscaledResiduals:
    """The unscaled residuals of rollouts that start at each multiple of the plant's horizon."""
    plant, horizon_s = predictor.plant, predictor.plant.horizon_s
    begin_s = float(episode.t_s[known_from(plant, episode)])
    starts = starts_every(episode.t_s[:-1], horizon_s, begin_s)
    if not len(starts):  # a velocity that nobody observes needs a span of positions
        nothing = np.zeros(0, np.int64)
        return UnscaledResiduals(
            np.zeros((0, len(plant.scales))),
            np.zeros(0),
            nothing,
            nothing,
            np.zeros(0),
            nothing,
            float(episode.t_s[-1]),
        )
    windows = cut(plant, episode, starts)
    with np.errstate(over="ignore", invalid="ignore"):  # running away is an answer
        values = (
            predict_observations(predictor, windows) - episode.observations[windows.rows]
        ) / plant.scales
    counts = windows.inside & (np.arange(windows.inside.shape[1]) > 0)
    rows = windows.rows[counts]
    since = episode.t_s[rows] - np.repeat(episode.t_s[windows.first], counts.sum(axis=1))
    number = np.repeat(np.arange(len(windows.first)), counts.sum(axis=1))
    return UnscaledResiduals(
        values[counts],
        episode.t_s[rows],
        rows,
        windows.first,
        since / horizon_s,
        number,
        float(episode.t_s[-1]),
    )


@dataclass(frozen=True, slots=True, eq=False)
class Residuals:
    """Normalised residuals of one episode, `values` `(samples, channels)`, finite; a channel that
    was not observed is 0 there.

    `weight` `(samples,)` is the time that each sample stands for, in horizons. `evidence`
    `(windows, signatures, 2)` is what each window's residuals have in common with each signature,
    and that signature's own power there.
    """

    values: Array
    t_s: Array
    weight: Array
    window: NDArray[np.int64]
    seconds: float
    evidence: Array

    @property
    def windows(self) -> int:
        """Rollouts in it."""
        return int(self.window[-1]) + 1 if len(self.window) else 0

    def mean_and_rms(self) -> tuple[list[float], list[float]]:
        """Mean and root mean square of each channel over the time of the episode, `(channels,)`."""
        if not len(self.weight):
            return [0.0] * self.values.shape[1], [0.0] * self.values.shape[1]
        share = self.weight / self.weight.sum()
        return [float(x) for x in share @ self.values], [
            float(x) for x in np.sqrt(share @ self.values**2)
        ]


@dataclass(frozen=True, slots=True, eq=False)
class Healthy:
    """Root mean square of healthy residuals, `(ages, channels)`, in declared units."""

    spread: Array

    @staticmethod
    def of(reference: Sequence[UnscaledResiduals]) -> Healthy:
        """The spread of healthy episodes, from their residuals."""
        values, age = (
            np.concatenate([m.values for m in reference]),
            np.concatenate([_bin(m.age) for m in reference]),
        )
        spread = np.stack(
            [
                _rms(values[age == i]) if (age == i).any() else np.full(values.shape[1], np.nan)
                for i in range(AGES)
            ]
        )
        whole = _rms(values)
        least = np.where(whole > 0.0, whole, 1.0) * 1e-6
        return Healthy(np.maximum(np.where(np.isfinite(spread), spread, whole), least))

    def residuals(self, of: UnscaledResiduals) -> Residuals:
        """Residuals in units of the healthy spread."""
        with np.errstate(over="ignore", invalid="ignore"):
            values = of.values / self.at(of)
        # running away; a channel that nobody observed is not
        gone = np.isnan(of.values) & np.isfinite(of.values).any(axis=0)
        values = np.where(
            gone, RAN_AWAY, np.nan_to_num(values, nan=0.0, posinf=RAN_AWAY, neginf=-RAN_AWAY)
        )
        starts = np.diff(of.window, prepend=-1) > 0
        weight = np.where(starts, of.age, np.diff(of.age, prepend=0.0))
        return Residuals(
            np.clip(values, -RAN_AWAY, RAN_AWAY),
            of.t_s,
            weight,
            of.window,
            of.seconds,
            np.zeros((0, 0, 2)),
        )

    def at(self, of: UnscaledResiduals) -> Array:
        """The healthy spread at each sample, `(samples, channels)`."""
        return np.asarray(self.spread[_bin(of.age)])

    def document(self) -> list[Json]:
        """The spread as JSON."""
        return [[float(x) for x in row] for row in self.spread]

    @staticmethod
    def from_document(document: Any) -> Healthy:
        """Read what `document` returned. Raises ValueError."""
        spread = np.array(document, np.float64)
        if spread.ndim != 2 or len(spread) != AGES or not (spread > 0.0).all():  # noqa: PLR2004
            raise ValueError("a healthy spread is a table of positive numbers, ages by channels")
        return Healthy(spread)


def blocks(of: Residuals, windows: int) -> list[Residuals]:
    """Parts of `windows` whole rollouts each; what is left over at the end is dropped."""
    parts = []
    for k in range(of.windows // windows):
        inside = (of.window >= k * windows) & (of.window < (k + 1) * windows)
        part = of.values[inside], of.t_s[inside], of.weight[inside], of.window[inside] - k * windows
        parts.append(
            Residuals(
                *part,
                of.seconds * windows / of.windows,
                of.evidence[k * windows : (k + 1) * windows],
            )
        )
    return parts


def _bin(age: Array) -> NDArray[np.int64]:
    return np.clip(np.ceil(age * AGES - TOUCH).astype(np.int64) - 1, 0, AGES - 1)


def _rms(values: Array) -> Array:
    known = np.isfinite(values)
    count = np.maximum(known.sum(axis=0), 1)
    return np.asarray(np.sqrt((np.where(known, values, 0.0) ** 2).sum(axis=0) / count))
