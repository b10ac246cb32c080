"""What sensors show of a simulator's rollout, which nothing in the rollout depends on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trueup.model.series import Series
from trueup.model.simulator.timeline import Acting

Array = NDArray[np.float64]


def shown(
    s: Series,
    sensors: Sequence[Acting],
    starts: NDArray[np.int64],
    states: Array,
    ended: Array,
    following: int,
    follows: Mapping[Any, Array] | None = None,
) -> Array:
    """Positions and velocities as they are observed, `(samples, 2, lanes)`, of the true ones.

    What a sensor remembers at the `starts` of windows runs through, with the velocity set from the
    one with which the last window `ended` `(windows, lanes)`, and so many lanes behind the first
    are `following` it; or it is what a filter has there `(samples,)`.
    """
    since = np.diff(s.t_s, prepend=s.t_s[0])
    signals: dict[str, Any] = {
        "q": states[:, 0],
        "v": states[:, 1],
        "t": s.t_s[:, None],
        "since": since[:, None],
        "period": s.period_s,
        "u_scale": float(s.u_scale[0]),
    }
    for one in sensors:
        if one.effect.states:
            seen = _in_turn(s, one, signals, starts, states, ended, following, follows)
        else:
            seen = tuple(one.value(signals, {}))
        signals["q"], signals["v"] = (np.broadcast_to(x, states[:, 0].shape) for x in seen)
    return np.stack([signals["q"], signals["v"]], axis=1)


def followed(hidden: Array, following: int) -> Array:
    """What lanes `(lanes, …)` remember where so many behind the first remember what it does."""
    if not following:
        return hidden
    after = hidden.copy()
    after[1 : 1 + following] = hidden[0]
    return after


def _in_turn(
    s: Series,
    one: Acting,
    signals: Mapping[str, Any],
    starts: NDArray[np.int64],
    states: Array,
    ended: Array,
    following: int,
    follows: Mapping[Any, Array] | None,
) -> tuple[Array, Array]:
    """What a sensor shows that remembers, one sample after the other."""
    lanes = states.shape[2]
    keys = [(one.effect.name, state) for state in one.effect.states]
    memory = one.begin(s.issued[0, 0], lanes)
    q, v = np.empty_like(states[:, 0]), np.empty_like(states[:, 0])
    windows = {int(sample): w for w, sample in enumerate(starts)}
    changing = [k for k, x in signals.items() if np.ndim(x)]
    now = dict(signals)
    for i in range(len(s.t_s)):
        if i in windows and follows is not None:
            memory = {key: np.full(lanes, follows[key][i]) for key in keys}
        elif i in windows:
            if one.effect.hides_velocity:  # to set a velocity is no motion
                memory[keys[1]] = memory[keys[1]] + states[i, 1] - ended[windows[i]]
            memory = {key: followed(x, following) for key, x in memory.items()}
        for k in changing:
            now[k] = signals[k][i]
        if i in windows and follows is not None:
            q[i], v[i] = states[i]  # of a window's start the filter's own is told
            continue
        q[i], v[i], *after = one.value(now, memory)
        memory = dict(zip(keys, after, strict=True))
    return q, v
