"""The state at a sample, from the observations around it.

An observed position or velocity is taken as it is. A velocity that nobody observes is the slope of a parabola fitted to
the positions of the last `SPAN_S`, or around the sample where the future may be looked at.
Source: A. Savitzky, M. J. E. Golay, Analytical Chemistry 36 (1964), for the local fit; here at irregular times.
"""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from trueup.episode.episode import Episode
from trueup.model.plant import Plant

Array = NDArray[np.float64]
SPAN_S = 0.01  # long against encoder noise at 1 kHz, short against a joint's own motion
LEAST_SAMPLES = 5  # a parabola through noise needs more than its three points


def past_states(plant: Plant, episode: Episode) -> Array:
    """State at each sample from this and earlier samples, `(samples, 2 x joints)`."""
    return _states(plant, episode, ahead=0)


def smoothed_states(plant: Plant, episode: Episode) -> Array:
    """State at each sample from samples on both sides, `(samples, 2 x joints)`; for fits, never for predictions."""
    return _states(plant, episode, ahead=_span(episode) // 2)


def known_from(plant: Plant, episode: Episode) -> int:
    """The first sample at which the past gives the whole state: a velocity that nobody observes needs a span of positions."""
    observed = len(plant.layout.observations) == 2 * plant.dynamics.joints and not episode.missing
    return 0 if observed else min(_span(episode), len(episode.t_s) - 1)


def _span(episode: Episode) -> int:
    return max(LEAST_SAMPLES, round(SPAN_S / episode.period_s) + 1)


def _states(plant: Plant, episode: Episode, ahead: int) -> Array:
    states = np.full((len(episode.t_s), 2 * plant.dynamics.joints), np.nan)
    states[:, plant.state_columns] = episode.observations
    for joint in range(plant.dynamics.joints):
        column = plant.dynamics.joints + joint
        if np.isnan(states[:, column]).any():
            states[:, column] = _slopes(episode.t_s, states[:, joint], _span(episode), ahead)
    return states


def _slopes(t_s: Array, q: Array, span: int, ahead: int) -> Array:
    """Slope at each sample of the parabola through `span` samples that end `ahead` samples later; 0 where all is one sample."""
    before = span - 1 - ahead
    at = np.arange(len(t_s))
    padded_t = np.concatenate([np.full(before, np.nan), t_s, np.full(ahead, np.nan)])
    padded_q = np.concatenate([np.full(before, np.nan), q, np.full(ahead, np.nan)])
    t = sliding_window_view(padded_t, span)[at] - t_s[:, None]
    y = sliding_window_view(padded_q, span)[at]
    known = np.isfinite(t)
    width = span * np.median(np.diff(t_s))
    x = np.where(known, t, 0.0)[:, :, None] / width
    powers = np.concatenate([np.ones_like(x), x, x * x], axis=2) * known[:, :, None]
    weights = np.linalg.pinv(powers)
    return np.asarray(np.einsum("ns,ns->n", weights[:, 1], np.where(known, y, 0.0)) / width)
