"""Screening: what a linear model expects of an effect before any fit of it.

What the effect does to a parent's rollouts is scaled by one factor, and everything that the parent
leaves free adapts to it. One lane for each initial guess of the effect.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trueup.fit.errors import KeptDerivatives
from trueup.fit.lanes import Task
from trueup.fit.normal_equations import RAN_AWAY, NormalEquations
from trueup.fit.rollout_fit import RolloutFit
from trueup.fit.rollouts import Rollouts
from trueup.model.block import BLOCK, kind
from trueup.model.rounding import rounded
from trueup.model.series import Series

Array = NDArray[np.float64]
UNSEEN = 1e-6  # squared standard errors that an effect makes where the log cannot have shown it
RIDGE = 1e-9  # of a determined number's information


@dataclass(frozen=True, slots=True)
class Screening:
    """For each initial guess of an effect `(guesses,)`: the cost expected once it acts, the factor
    on it, and that factor's standard error.

    `like` is the free number of the parent that changes the rollouts most like the effect, -1 where
    there is none, `correlation` that of their estimates.
    """

    cost: Array
    factor: Array
    error: Array
    like: NDArray[np.int64]
    correlation: Array


def screen(
    rollouts: Rollouts,
    data: Sequence[Series],
    parent: RolloutFit,
    effect: str,
    derivatives: KeptDerivatives | None = None,
    guesses: Sequence[Sequence[float]] = (),
) -> Screening:
    """What is expected of each initial guess of an effect, of its own ones where none are given.

    `derivatives` are the parent's. Where the parent's own parameters leave no lane, nothing can be
    said: the cost is the parent's, and the error infinite.
    """
    task = rollouts.task(data, parent.hypothesis, rollouts.free(parent.hypothesis))
    task = replace(
        task,
        hypothesis=parent.hypothesis | effect,
        states=(),
        keeps=task.keeps if derivatives else 0,
    )
    guesses = guesses or kind(effect).starts
    own = len(task.free.rows) - task.keeps
    room = BLOCK - 1 - own if task.keeps else rollouts.room() - own
    if room <= 0:
        n = len(guesses)
        return Screening(
            np.full(n, parent.cost),
            np.zeros(n),
            np.full(n, np.inf),
            np.full(n, -1),
            np.zeros(n),
        )
    parts = [
        _screened(rollouts, task, parent, effect, guesses[i : i + room], derivatives)
        for i in range(0, len(guesses), room)
    ]
    cost, factor, error, like, correlation = np.concatenate(parts, axis=1)
    return Screening(rounded(cost), factor, error, like.astype(np.int64), correlation)


def _screened(
    rollouts: Rollouts,
    task: Task,
    parent: RolloutFit,
    effect: str,
    guesses: Sequence[Sequence[float]],
    derivatives: KeptDerivatives | None,
) -> Array:
    """The rows of a Screening `(5, guesses)`, of no more guesses than there are lanes."""
    n, k = len(task.free.rows), len(guesses)
    lanes = rollouts.lanes(task, parent.values, task.keeps, k)
    off = list(rollouts.block.rows(effect))
    lanes.p[off] = rollouts.block.nulls[off, None]
    for lane, guess in zip(lanes.of[len(lanes.of) - k :], guesses, strict=True):
        lanes.p[:, lane] = rollouts.with_effect(parent.values, effect, guess)
        lanes.inverse[lane] = 1.0
    sums, *_ = rollouts.sums(task, lanes, parent.starts, {}, derivatives if task.keeps else None)
    ends = task.stack.window_ends
    nothing = np.zeros((len(ends) - 1, 0))
    sound = np.where(np.abs(sums) < RAN_AWAY, sums, 0.0)
    equations = NormalEquations(sound, ends, nothing, np.zeros(0), n + k)
    normal, gradient = equations.reduced(RIDGE)
    expected = np.array([[parent.cost] * k, [0.0] * k, [np.inf] * k, [-1.0] * k, [0.0] * k])
    for i in range(k):
        columns = [*range(n), n + i]
        diagonal = np.diag(normal)[columns]
        if not diagonal[-1] > UNSEEN:
            continue
        size = np.sqrt(np.maximum(diagonal, UNSEEN))
        inverse_part = np.linalg.inv(
            normal[np.ix_(columns, columns)] / size[:, None] / size + RIDGE * np.eye(n + 1)
        )
        by = inverse_part @ (gradient[columns] / size)
        gained = float(by @ (gradient[columns] / size)) if by[-1] > 0.0 else 0.0
        if kind(effect).grid_refined:  # it does not grow in proportion: as it is, or not at all
            rest, pulled = columns[:-1], gradient[columns[:-1]] - normal[columns[:-1], n + i]
            adapted = np.linalg.lstsq(normal[np.ix_(rest, rest)], pulled, rcond=None)[0]
            gained = 2.0 * gradient[n + i] - normal[n + i, n + i] + float(pulled @ adapted)
        if not inverse_part[-1, -1] > 0.0:  # by rounding: it is told from nothing
            continue
        error = np.sqrt(inverse_part[-1, -1]) / size[-1]
        like, correlation = _likest(np.asarray(inverse_part))
        expected[:, i] = parent.cost - gained, by[-1] / size[-1], error, like, correlation
    return expected


def _likest(covariance: Array) -> tuple[int, float]:
    """Which of the other numbers of a covariance the last one is confused with most, and their
    correlation."""
    deviation = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    correlations = np.abs(covariance[-1, :-1] / deviation[:-1] / deviation[-1])
    if not len(correlations):
        return -1, 0.0
    like = int(np.argmax(correlations))
    return like, float(correlations[like])
