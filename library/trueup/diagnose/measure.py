"""Measure: how far the gap closes on held-out episodes, from rollouts that start as `trueup
predict` starts them.

error    root mean square over samples and channels of (predicted - observed) / the channel's
         standard deviation over the held-out episodes; rollouts start at each multiple of the
         horizon, and the starting samples do not count; where no velocity is observed an episode's
         first rollout starts in ignorance of it, which is not the model's gap, and does not count
         either, and so where the corrected model remembers what was before the log: a drive's lag,
         a play, heat
floor    what the noise does to the compared sample, and to the prediction through the state from
         which a window starts: the latter is how far predictions move when the episodes are given
         noise of the same size and colour once more
closed   1 - (after^2 - floor^2) / (before^2 - floor^2)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trueup.bootstrap import LEAST
from trueup.canonical import Json
from trueup.diagnose.noise import Noise
from trueup.diagnose.tuning_of_answers import EVIDENCE
from trueup.episode.episode import Episode
from trueup.model.block import kind
from trueup.model.corrected import Corrected
from trueup.model.plant import Plant
from trueup.model.predictor import Nominal, Predictor
from trueup.model.state import is_observed
from trueup.model.windows import Windows, cut, starts_every

Array = NDArray[np.float64]
RAN_AWAY = 1e6  # standard deviations: no error is larger


@dataclass(frozen=True, slots=True)
class ChannelGap:
    """Held-out errors of one channel, in units of its standard `deviation`, which is in the
    channel's own `unit`."""

    before: float
    after: float
    deviation: float
    unit: str

    def document(self) -> dict[str, Json]:
        """The errors as JSON."""
        return asdict(self)


@dataclass(frozen=True, slots=True)
class Gap:
    """Held-out errors: `before` of the nominal model; `same_numbers` of the same with the answer's
    integration and a filtered start; `parameters_only` of the refitted nominal form;
    `effects_only` of the answer's effects on the declared parameters, None where it has none;
    `after` of the answer; `floor` what noise alone makes. `closed` is None where there was nothing
    to close."""

    horizon_s: float
    before: float
    same_numbers: float
    parameters_only: float
    after: float
    floor: float
    closed: float | None
    ci95: tuple[float, float] | None
    by_channel: dict[str, ChannelGap]
    effects_only: float | None = None
    beginnings: bool = True  # whether the windows that start with the logs are counted

    @property
    def at_the_floor(self) -> bool:
        """Whether what is left is no more than what noise does."""
        return self.after**2 <= EVIDENCE.at_the_floor * self.floor**2

    @property
    def was_at_the_floor(self) -> bool:
        """Whether the nominal model predicts as well as noise allows."""
        return self.before <= self.floor

    def document(self) -> dict[str, Json]:
        """The gap as JSON, a field of the report."""
        return {
            "metric": "normalised rollout RMS, held out",
            "horizon_s": self.horizon_s,
            "before": self.before,
            "same_numbers": self.same_numbers,
            "parameters_only": self.parameters_only,
            "effects_only": self.effects_only,
            "after": self.after,
            "floor": self.floor,
            "closed": self.closed,
            "ci95": list(self.ci95) if self.ci95 else None,
            "beginnings": "counted" if self.beginnings else "left out",
            "channels": {name: errors.document() for name, errors in self.by_channel.items()},
        }


def squared_errors(predictor: Predictor, windows: Sequence[Windows], motion: Array) -> Array:
    """Mean squared normalised error of each window of some episodes, `(windows,)`."""
    return np.asarray(by_channel(predictor, windows, motion).mean(axis=1))


def squared_errors_of(
    plant: Plant, rolled: Sequence[Array], windows: Sequence[Windows], motion: Array
) -> Array:
    """`squared_errors` of rollouts over these windows, states `(windows, samples, states)` of each
    episode."""
    return np.asarray(_by_channel(plant, rolled, windows, motion).mean(axis=1))


def knows_beginnings(model: Predictor) -> bool:
    """Whether a log's first sample says all that a model starts from: nothing acts that remembers
    what was before it."""
    return not (
        isinstance(model, Corrected) and any(kind(t).memory for t in model.hypothesis.effects)
    )


def _floor(
    corrected: Predictor,
    episode: Episode,
    horizon_s: float,
    motion: Array,
    noise: Noise,
    rng: np.random.Generator,
    beginnings: bool,
) -> Array:
    """The noise's own part of each window's squared error, `(windows, channels)`."""
    plant = corrected.plant
    seen = plant.state_columns
    sigma = np.nan_to_num(noise.sigma[seen])
    more = noise.drawn(rng, len(episode.t_s), seen)
    again = replace(
        episode, observations=episode.observations + more, digest=episode.digest + "/again"
    )
    paths = []
    for e in (episode, again):
        (windows,) = windows_of(plant, [e], horizon_s, beginnings=beginnings)
        paths.append(plant.observe(corrected.rollout(windows)))
    moved = np.where(windows.inside[:, :, None], (paths[1] - paths[0]) / motion[seen], 0.0) ** 2
    return np.asarray(
        moved.sum(axis=1) / windows.inside.sum(axis=1)[:, None] + (sigma / motion[seen]) ** 2
    )


def windows_of(
    plant: Plant, episodes: Sequence[Episode], horizon_s: float, *, beginnings: bool
) -> list[Windows]:
    """Windows of each episode at each multiple of the horizon; without beginnings, or without an
    observed velocity, the first only if it is alone.
    """
    every = []
    for e in episodes:
        first = starts_every(e.t_s[:-1], horizon_s)
        every.append(
            cut(
                plant,
                e,
                first if (beginnings and is_observed(plant, e)) or len(first) == 1 else first[1:],
            )
        )
    return every


def by_channel(predictor: Predictor, windows: Sequence[Windows], motion: Array) -> Array:
    """Mean squared normalised error of each window and observed channel, `(windows, channels)`."""
    return _by_channel(predictor.plant, predictor.rollouts(windows), windows, motion)


def _by_channel(
    plant: Plant, rolled: Sequence[Array], windows: Sequence[Windows], motion: Array
) -> Array:
    pairs = zip(rolled, windows, strict=True)
    return np.concatenate([_of_episode(plant, states, w, motion) for states, w in pairs])


def _of_episode(plant: Plant, states: Array, windows: Windows, motion: Array) -> Array:
    episode = windows.episode
    with np.errstate(over="ignore", invalid="ignore"):
        missed = (plant.observe(states) - episode.observations[windows.rows]) / motion[
            plant.state_columns
        ]
        missed = np.clip(
            np.nan_to_num(missed, nan=RAN_AWAY, posinf=RAN_AWAY, neginf=RAN_AWAY),
            -RAN_AWAY,
            RAN_AWAY,
        )
        counted = windows.inside & (np.arange(windows.inside.shape[1]) > 0)
        squares = np.where(
            counted[:, :, None] & np.isfinite(episode.observations[windows.rows]), missed**2, 0.0
        )
        return np.asarray(squares.sum(axis=1) / np.maximum(counted.sum(axis=1), 1)[:, None])


def measure(
    nominal: Predictor,
    same_numbers: Predictor,
    refitted: Predictor,
    corrected: Predictor,
    episodes: Sequence[Episode],
    noise: Noise,
    seed: int,
) -> Gap:
    """The gap on held-out episodes; `same_numbers` is the nominal model, integrated as the
    corrected one and started from a filter of its own."""
    plant: Plant = corrected.plant
    rng = np.random.default_rng(seed)
    motion = motion_of(plant, episodes)
    horizon = plant.horizon_s
    begun = knows_beginnings(corrected)
    windows = windows_of(plant, episodes, horizon, beginnings=begun)
    tables = [by_channel(p, windows, motion) for p in (nominal, same_numbers, refitted, corrected)]
    before, same, parameters, after = (t.mean(axis=1) for t in tables)
    floor = np.concatenate(
        [_floor(corrected, e, horizon, motion, noise, rng, begun) for e in episodes]
    )
    least = np.nan_to_num(floor.mean(axis=1))
    base = float(least.mean())
    closed, ends = None, None
    if before.mean() > EVIDENCE.at_the_floor * base:
        closed = _closed(before.mean(), after.mean(), base)
        ends = _closed_ci95(before, after, base, rng)
    channels = {
        c.name: ChannelGap(
            _root(tables[0][:, i]), _root(tables[-1][:, i]), float(motion[column]), c.unit
        )
        for i, (c, column) in enumerate(
            zip(plant.layout.observations, plant.state_columns, strict=True)
        )
    }
    counted = all(w.first[0] == 0 for w in windows)
    return Gap(
        horizon,
        before=_root(before),
        same_numbers=_root(same),
        parameters_only=_root(parameters),
        after=_root(after),
        floor=_root(least),
        closed=closed,
        ci95=ends,
        by_channel=channels,
        effects_only=_effects_only(corrected, windows, motion),
        beginnings=counted,
    )


def _effects_only(corrected: Predictor, windows: Sequence[Windows], motion: Array) -> float | None:
    """The error of an answer's effects on the declared parameters; None of an answer without
    effects."""
    if not (isinstance(corrected, Corrected) and corrected.hypothesis.effects):
        return None
    declared = corrected.with_parameters(corrected.plant.parameters)
    return _root(squared_errors(declared, windows, motion))


def held_out_error(predictor: Predictor, episodes: Sequence[Episode]) -> float:
    """Root mean square error of a predictor on held-out episodes, as a gap has it but for the
    windows with which logs begin."""
    plant = predictor.plant
    windows = windows_of(plant, episodes, plant.horizon_s, beginnings=False)
    return _root(squared_errors(predictor, windows, motion_of(plant, episodes)))


def closed_on(corrected: Predictor, episodes: Sequence[Episode], sigma: Array) -> float | None:
    """The part of the nominal model's gap that a predictor closes on further episodes; None where
    there was none above their noise."""
    plant = corrected.plant
    motion = motion_of(plant, episodes)
    windows = windows_of(plant, episodes, plant.horizon_s, beginnings=knows_beginnings(corrected))
    before, after = (
        float(np.mean(squared_errors(p, windows, motion))) for p in (Nominal(plant), corrected)
    )
    floor = float(np.mean((np.nan_to_num(sigma) / motion)[plant.state_columns] ** 2))
    return _closed(before, after, floor) if before > EVIDENCE.at_the_floor * floor else None


def motion_of(plant: Plant, episodes: Sequence[Episode]) -> Array:
    """Standard deviation of positions and velocities over all episodes `(2 x joints,)`, 1 where not
    observed."""
    motion = np.ones(2 * len(plant.joints))
    motion[plant.state_columns] = [
        max(float(np.nanstd(np.concatenate([e.observations[:, i] for e in episodes]))), 1e-12)
        for i in range(len(plant.scales))
    ]
    return motion


def _closed_ci95(
    before: Array, after: Array, base: float, rng: np.random.Generator
) -> tuple[float, float] | None:
    """The 95 % bootstrap interval over windows, answer and nominal model drawn alike; None where
    there are few windows.

    By hand, since scipy.stats.bootstrap keeps draws in which there is no gap to close.
    """
    if len(before) < LEAST:
        return None
    drawn = rng.integers(0, len(before), (EVIDENCE.resamples, len(before)))
    pairs = zip(before[drawn].mean(axis=1), after[drawn].mean(axis=1), strict=True)
    spread = [_closed(b, a, base) for b, a in pairs if b > base]
    if not spread:
        return None
    low, high = np.quantile(spread, [0.025, 0.975])
    return float(low), float(high)


def _root(squares: Array) -> float:
    """Root of a mean of squares."""
    return float(np.sqrt(squares.mean()))


def _closed(before: float, after: float, floor: float) -> float:
    return float(min(1.0, 1.0 - (after - floor) / (before - floor)))
