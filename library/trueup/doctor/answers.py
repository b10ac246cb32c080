"""Answers: whether a command answers what a sensor shows, and when.

In a closed loop the noise of a position goes into the command, at once or a little later, never
before. High differences of both take away what is smooth, the motion and its reference; what is
left of the command follows what is left of the position, by the gain of the loop.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueup.doctor.log import Log
from trueup.doctor.tuning import LOOP
from trueup.episode.episode import Episode
from trueup.model.series import positions_and_velocities

Array = NDArray[np.float64]
Fast = tuple[Array, Array, Array]  # fast changes of a position, its velocity and its command
ORDER = 4  # of the differences: those that tell noise


@dataclass(frozen=True, slots=True)
class Loop:
    """What a joint's command does with what its sensors show.

    `kind` is open, P or PD; `position` and `velocity` are the gains [command per unit], 0 where
    there is none; `explained` is the part of the command's fast changes that they explain.
    """

    kind: str
    position: float
    velocity: float
    explained: float


OPEN = Loop("open", 0.0, 0.0, 0.0)


def loop(log: Log, joint: int) -> Loop | None:
    """The loop that a joint's command closes; None where it has no command."""
    fast = _of_log(log, joint)
    return None if fast is None else _fitted(fast, 0)


def answered_early_s(log: Log) -> float | None:
    """By how much commands answer the noise of positions before those show it [s], None where they
    do not, or where no loop is seen to be closed."""
    period_s = float(np.median([e.period_s for e in log.episodes]))
    furthest = max(LOOP.samples + 1, round(LOOP.longest_s / period_s))
    for joint in range(len(log.plant.joints)):
        fast = _of_log(log, joint)
        if fast is None:
            continue
        explained = [_fitted(fast, lag).explained for lag in range(furthest + 1)]
        early = int(np.argmax(explained))
        if early > LOOP.samples and explained[early] > LOOP.certain:
            return early * period_s
    return None


def _fitted(fast: Sequence[Fast], early: int) -> Loop:
    """The gains that explain the commands by what is shown so many samples later."""
    design, target = [], []
    for q, v, u in fast:
        if len(u) > early + 1:
            ends = len(u) - early
            design.append(np.column_stack([q[early:], v[early:]]))
            target.append(u[:ends])
    if not target:
        return OPEN
    x, y = np.concatenate(design), np.concatenate(target)
    power, size = float(y @ y), np.sqrt(np.mean(x**2, axis=0))
    if power <= 0.0 or not size.any():
        return OPEN
    gains, used = np.zeros(2), size > 0.0
    gains[used] = np.linalg.lstsq(x[:, used] / size[used], y, rcond=1e-9)[0] / size[used]
    explained = 1.0 - float(np.sum((y - x @ gains) ** 2)) / power
    if explained < LOOP.certain:
        return Loop("open", 0.0, 0.0, max(explained, 0.0))
    damped = abs(gains[1]) * size[1] > LOOP.part * abs(gains[0]) * size[0]
    return Loop(
        "PD" if damped else "P", -float(gains[0]), -float(gains[1]) if damped else 0.0, explained
    )


def _of_log(log: Log, joint: int) -> list[Fast] | None:
    at = log.command(joint)
    return None if at is None else [_fast(log, e, joint, at) for e in log.episodes]


def _fast(log: Log, e: Episode, joint: int, at: int) -> Fast:
    """High differences of a joint's position, velocity and command, those that touch no missing
    value, and no command at its limit, where it answers nothing."""
    observed = positions_and_velocities(log.plant, e)
    v = observed[:, len(log.plant.joints) + joint]
    v = v if np.isfinite(v).any() else np.zeros(len(v))
    low, high = log.plant.limits[0][at], log.plant.limits[1][at]
    u = np.where((e.commands[:, at] > low) & (e.commands[:, at] < high), e.commands[:, at], np.nan)
    columns = np.diff(np.column_stack([observed[:, joint], v, u]), n=ORDER, axis=0)
    known = columns[np.isfinite(columns).all(axis=1)]
    return known[:, 0], known[:, 1], known[:, 2]
