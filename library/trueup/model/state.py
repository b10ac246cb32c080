"""The state at a sample, from the observations around it.

An observed position or velocity is taken as it is. A velocity that nobody observes is the slope of
a parabola fitted to the positions of the last `SPAN_S`, or around the sample where the future may
be looked at. Source: A. Savitzky, M. J. E. Golay, Analytical Chemistry 36 (1964), for the local
fit; here at irregular times.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from trueup.episode.episode import GAP_PERIODS, Episode
from trueup.model.plant import Plant

Array = NDArray[np.float64]
Rows = NDArray[np.int64] | slice
ALL = slice(None)
SPAN_S = 0.01  # long against encoder noise at 1 kHz, short against a joint's own motion
MOST_SAMPLES = 201  # at 10 kHz; more adds cost and no knowledge
BLOCK_VALUES = 1_000_000  # rows are taken in blocks of about so many numbers, 8 MB
# of a line's power squared: so little is left of a parabola through times of which only two are
# distinct
STRAIGHT = 1e-20
LEAST_SAMPLES = 5  # a parabola through noise needs more than its three points


def past_states(plant: Plant, episode: Episode, rows: Rows = ALL) -> Array:
    """State at each sample, or at some `rows` of them, from this and earlier samples, `(samples, 2
    x joints)`."""
    return _states(plant, episode, rows, 0, from_positions=False)


def smoothed_states(
    plant: Plant, episode: Episode, rows: Rows = ALL, *, from_positions: bool = False
) -> Array:
    """State at each sample, or at some `rows`, from samples on both sides, `(samples, 2 x joints)`;
    for fits, never for predictions.

    With `from_positions` logged velocities are left aside.
    """
    return _states(plant, episode, rows, _span(episode) // 2, from_positions)


def slope_deviation(period_s: float) -> float:
    """Standard deviation of a smoothed velocity for positions with noise of standard deviation 1,
    at a sampling period [s]."""
    ahead = _samples_in_span(period_s) // 2
    return 1.0 / (period_s * math.sqrt(ahead * (ahead + 1) * (2 * ahead + 1) / 3.0))


def known_from(plant: Plant, episode: Episode) -> int:
    """The first sample at which the past gives the whole state: a velocity that nobody observes
    needs a span of positions."""
    return 0 if is_observed(plant, episode) else min(_span(episode), len(episode.t_s) - 1)


def is_observed(plant: Plant, episode: Episode) -> bool:
    """Whether every position and velocity was observed."""
    return len(plant.layout.observations) == 2 * plant.dynamics.joints and not episode.missing


def _span(episode: Episode) -> int:
    """Samples in SPAN_S, within reason and the episode."""
    return min(_samples_in_span(_period_s(episode.t_s)), len(episode.t_s))


def _samples_in_span(period_s: float) -> int:
    return min(max(LEAST_SAMPLES, round(SPAN_S / period_s) + 1), MOST_SAMPLES)


def _period_s(t_s: Array) -> float:
    """The interval that nine in ten do not exceed: neither bursts of stamps nor a gap move it
    far."""
    return float(np.quantile(np.diff(t_s), 0.9))


def _states(plant: Plant, episode: Episode, rows: Rows, ahead: int, from_positions: bool) -> Array:
    states = np.full((len(episode.t_s), 2 * plant.dynamics.joints), np.nan)
    states[:, plant.state_columns] = episode.observations
    joints = plant.dynamics.joints
    asked = np.flatnonzero(np.isnan(states[:, joints:]).any(axis=0) | from_positions)
    wanted = states[rows]
    if len(asked):
        at = np.arange(len(episode.t_s))[rows]
        wanted[:, joints + asked] = _slopes(
            at, episode.t_s, states[:, asked], _span(episode), ahead
        )
    return wanted


def _slopes(at: NDArray[np.int64], t_s: Array, q: Array, span: int, ahead: int) -> Array:
    """Slope of each joint's positions `(samples, joints)` at the samples `at`, of the parabola
    through `span` samples that end `ahead` samples later, `(at, joints)`.

    Samples on the other side of a gap do not count; of two a line is left, of one nothing, and the
    slope is 0.
    """
    reach_s = GAP_PERIODS * span * _period_s(t_s)
    blocks = np.array_split(at, len(at) * span // BLOCK_VALUES + 1)
    return np.concatenate([_slopes_at(rows, t_s, q, span, ahead, reach_s) for rows in blocks])


def _slopes_at(
    rows: NDArray[np.int64], t_s: Array, q: Array, span: int, ahead: int, reach_s: float
) -> Array:
    index = rows[:, None] + np.arange(ahead + 1 - span, ahead + 1)
    inside = np.clip(index, 0, len(t_s) - 1)
    t = t_s[inside] - t_s[rows, None]
    known = (index == inside) & (np.abs(t) <= reach_s)
    scale = reach_s / GAP_PERIODS
    x = np.where(known, t / scale, 0.0)
    return np.asarray(
        np.einsum("ns,nsj->nj", _weights(x, known), np.where(known[:, :, None], q[inside], 0.0))
        / scale
    )


def _weights(x: Array, known: NDArray[np.bool_]) -> Array:
    """What each value counts in the slope at 0 of the parabola through those that are known,
    `(rows, samples)` each.

    By polynomials that are orthogonal over the known times, without a solver, so that each
    processor gives the same bits. Source: G. E. Forsythe, Journal of the SIAM 5 (1957).
    """
    many = known.sum(axis=1, keepdims=True)
    mean = np.sum(x, axis=1, keepdims=True) / np.maximum(many, 1)
    line = np.where(known, x - mean, 0.0)
    power = np.sum(line**2, axis=1, keepdims=True)
    power = np.where(power > 0.0, power, np.inf)
    tilt, level = (
        np.sum(line**3, axis=1, keepdims=True) / power,
        np.sum(line**2, axis=1, keepdims=True) / np.maximum(many, 1),
    )
    bend = np.where(known & (many > 2), line**2 - tilt * line - level, 0.0)  # noqa: PLR2004  (a parabola has three coefficients)
    curved = np.sum(bend**2, axis=1, keepdims=True)
    slope = -2.0 * mean - tilt  # of the bend at 0
    return np.asarray(
        line / power
        + bend
        * slope
        / np.where(curved > STRAIGHT * power**2 / np.maximum(many, 1), curved, np.inf)
    )
