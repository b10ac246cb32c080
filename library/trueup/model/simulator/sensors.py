"""What sensors show of a simulator's rollout, which nothing in the rollout depends on."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trueup.model.simulator.run import Run
from trueup.model.simulator.timeline import Acting
from trueup.model.stepping import between

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class Followed:
    """An episode as the filter follows it: its `states` `(samples, states)` and what effects
    remember `(samples,)`, once corrected; where it had `passed`, before, and what it had `shown`,
    `(samples, 2 x joints)` each."""

    states: Array
    memory: Mapping[tuple[str, str], Array]
    passed: Array
    shown: Array


def shown(run: Run, states: Array, ended: Array, follows: Followed | None = None) -> Array:
    """Positions and velocities as they are observed, `(samples, 2 x joints, lanes)`, of the true
    ones.

    What a sensor remembers where windows start runs through, with the velocity set from the one
    with which the last window `ended` `(windows, lanes, joints)`, and the lanes that follow the
    first remember what it does; or it is what a filter has there.
    """
    s, joints = run.series, run.step.simulator.joints
    since = np.diff(s.t_s, prepend=s.t_s[0])
    signals: dict[str, Any] = {
        "t": s.t_s[:, None],
        "since": since[:, None],
        "period": s.period_s,
    }
    seen = np.empty_like(states)
    for j in range(joints):
        now, at = _late(run, j, states, follows), [j, joints + j]
        signals |= {"q": now[:, 0], "v": now[:, 1], "u_scale": float(s.u_scale[j])}
        for one in run.sensors:
            if one.joint != j:
                continue
            if one.effect.states:
                after = _in_turn(run, one, signals, states[:, at], ended[:, :, j], follows)
            else:
                after = tuple(one.value(signals, {}))
            signals["q"], signals["v"] = (np.broadcast_to(x, now[:, 0].shape) for x in after)
        seen[:, j], seen[:, joints + j] = signals["q"], signals["v"]
    return seen


def followed(hidden: Array, following: int) -> Array:
    """What lanes `(lanes, …)` remember where so many behind the first remember what it does."""
    if not following:
        return hidden
    after = hidden.copy()
    after[1 : 1 + following] = hidden[0]
    return after


def seen_late(t_s: Array, at: Index, late_s: Array, passed: Callable[[Index], Array]) -> Array:
    """Where a joint was `late_s` before the samples `at`, its position and velocity `(2, …)`, by a
    cubic through the two samples around, which `passed` gives."""
    when = t_s[at] - late_s
    k = np.clip(np.searchsorted(t_s, when, side="right") - 1, 0, np.maximum(at - 1, 0))
    first, second = passed(k), passed(np.minimum(k + 1, at))
    span = np.where(at > 0, t_s[np.minimum(k + 1, at)] - t_s[k], 1.0)
    seen = between((when - t_s[k]) / span, span, (first[0], first[1]), (second[0], second[1]))
    ahead = first[0] + (when - t_s[0]) * first[1], first[1]
    before = (when <= t_s[0]) | (at == 0)
    return np.stack([np.where(before, a, b) for a, b in zip(ahead, seen, strict=True)])


def _late(run: Run, joint: int, states: Array, follows: Followed | None) -> Array:
    """A joint's position and velocity as late as they are seen, `(samples, 2, lanes)`."""
    own = states[:, [joint, run.step.simulator.joints + joint]]
    late = run.late_s[joint] > 0.0
    if not late.any():
        return own
    samples = np.arange(len(own))[:, None]
    started = run.timeline.starts[np.searchsorted(run.timeline.starts, samples, "right") - 1]
    lanes = np.flatnonzero(late)

    def passed(k: Index) -> Array:
        now = own[k, :, lanes]
        if follows is not None:  # until its start a window has the filter's past
            first = follows.passed[:, [joint, run.step.simulator.joints + joint]][k]
            now = np.where((k <= started)[..., None], first, now)
        return np.moveaxis(now, -1, 0)

    seen = own.copy()
    seen[:, :, lanes] = seen_late(
        run.series.t_s, samples, run.late_s[joint, lanes], passed
    ).swapaxes(0, 1)
    return seen


def _in_turn(
    run: Run,
    one: Acting,
    signals: Mapping[str, Any],
    states: Array,
    ended: Array,
    follows: Followed | None,
) -> tuple[Array, Array]:
    """What a sensor shows that remembers, one sample after the other; of its joint's `states`
    `(samples, 2, lanes)` and the velocities with which windows `ended` `(windows, lanes)`."""
    s, lanes = run.series, states.shape[2]
    memory = one.begin(s.issued[0, one.joint], lanes)
    q, v = np.empty_like(states[:, 0]), np.empty_like(states[:, 0])
    windows = {int(sample): w for w, sample in enumerate(run.timeline.starts)}
    changing = [k for k, x in signals.items() if np.ndim(x)]
    now = dict(signals)
    for i in range(len(s.t_s)):
        if i in windows and follows is not None:
            memory = {key: np.full(lanes, follows.memory[key][i]) for key in one.keys}
        elif i in windows:
            if one.effect.hides_velocity:  # to set a velocity is no motion
                before = one.keys[1]
                memory[before] = memory[before] + states[i, 1] - ended[windows[i]]
            memory = {key: followed(x, run.following) for key, x in memory.items()}
        for k in changing:
            now[k] = signals[k][i]
        if i in windows and follows is not None:
            q[i], v[i] = states[i]  # of a window's start the filter's own is told
            continue
        q[i], v[i], *after = one.value(now, memory)
        memory = dict(zip(one.keys, after, strict=True))
    return q, v
