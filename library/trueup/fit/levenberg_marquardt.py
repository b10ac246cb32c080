"""Levenberg-Marquardt: the free numbers of a rollout fit, by damped steps on its normal equations.

A fit is a `State`, and `step` leads from one to the next without changing anything. Where
derivatives take several blocks of lanes, a step may use those of an earlier place; `renewed` takes
them anew, and `step` says when. Source: J. Nocedal, S. Wright, Numerical Optimization (2006),
section 10.3; C. T. Kelley, Solving Nonlinear Equations with Newton's Method (2003), section 2.4, on
derivatives of earlier places.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import Enum, auto

import numpy as np
from numpy.typing import NDArray

from trueup.fit.errors import KeptDerivatives
from trueup.fit.lanes import Task
from trueup.fit.normal_equations import NormalEquations
from trueup.fit.rollout_fit import Start
from trueup.fit.rollouts import Rollouts

Array = NDArray[np.float64]
DAMPING = 1e-3  # of the normal equations' diagonal, at the beginning
LEAST_DAMPING, MOST_DAMPING = 1e-9, 1e7  # beyond the most, nothing near a place is better
SHRINK_FAST, SHRINK, GROW, GROW_FAST = 0.04, 0.2, 10.0, 1e3  # times the damping
FULL_GAIN = 0.9  # of the expected decrease: a longer step would have gained more
FAIR_GAIN = 0.5  # of the expected decrease: a step that gains less wants new derivatives
ASTRAY = 100.0  # times the cost: a step that leads there was far too long, and does not count
ROUGH = 5e-3  # a tolerance beyond which a fit may end on earlier derivatives
NEGLIGIBLE = 0.02  # of a squared standard error: a decrease not worth an iteration
# times the mean squared error of a sample: what a robot's number costs that is off by its size.
# Neighbouring samples err alike, so the data count for less than their number
PRIOR = 50.0


class End(Enum):
    """Why a fit stops before its iterations are used up."""

    CONVERGED = auto()
    RAN_AWAY = auto()  # no derivatives can be taken where it is


@dataclass(frozen=True, slots=True)
class Objective:
    """What is minimised: squared normalised errors of a task's rollouts, and a prior on a robot's
    numbers, which are expected near a `centre` by weights `(free,)`."""

    rollouts: Rollouts
    task: Task
    samples: int
    weight: Array
    centre: Array

    @staticmethod
    def of(rollouts: Rollouts, task: Task) -> Objective:
        """The objective of a task."""
        weight, centre = rollouts.expected(task.free)
        return Objective(rollouts, task, rollouts.samples(task.stack), weight, centre)

    def prior(self, cost: float) -> Array:
        """Diagonal of the prior's normal matrix `(free,)` at a cost."""
        return PRIOR * cost / self.samples * self.weight


@dataclass(frozen=True, slots=True)
class State:
    """A place of a fit, and how its next step is taken.

    `values` is the block's vector, `equations` are the normal equations there. `derivatives` may be
    kept for the next step; they are `stale` where they are an earlier place's. `astray` says that
    the last step led so far off that it does not count as an iteration, `end` why the fit stops,
    None while it goes on.
    """

    values: Array
    starts: Mapping[str, Start]
    equations: NormalEquations
    derivatives: KeptDerivatives | None
    stale: bool
    damping: float = DAMPING
    astray: bool = False
    end: End | None = None


def begin(
    objective: Objective,
    values: Array,
    starts: Mapping[str, Start],
    derivatives: KeptDerivatives | None = None,
) -> State:
    """The state at a first place, with derivatives of a fit nearby where they are given."""
    stale = derivatives is not None and objective.task.keeps > 0
    equations, kept = objective.rollouts.evaluate(
        objective.task, values, starts, derivatives if stale else None
    )
    return State(values, starts, equations, kept, stale)


def minimise(objective: Objective, state: State, iterations: int, tolerance: float) -> State:
    """The state once it converged, ran away or used up its iterations. Steps that expect a decrease
    below `tolerance` of the cost end it."""
    left = iterations if np.isfinite(state.equations.cost) else 0
    while left and state.end is None:
        state = step(objective, state, tolerance)
        left -= not state.astray
    return state


def step(objective: Objective, state: State, tolerance: float) -> State:
    """The state after one step: at a better place, or where it was and damped more."""
    task, cost = objective.task, state.equations.cost
    at, prior = task.free.at(state.values), objective.prior(cost)
    by, moves, expected = state.equations.step(
        state.damping, at, task.free.low, task.free.high, prior, prior * (objective.centre - at)
    )
    if not expected > tolerance * cost + NEGLIGIBLE and not state.astray:
        # where rollouts for new derivatives run away, the fit ends
        fresh = renewed(objective, state) if state.stale and tolerance < ROUGH else None
        return fresh or replace(state, end=End.CONVERGED)
    values = task.free.moved(state.values, by)
    starts = task.moved(state.starts, moves)
    equations, kept = objective.rollouts.evaluate(task, values, starts, state.derivatives)
    there = task.free.at(values)
    nearer = (at - objective.centre) ** 2 - (there - objective.centre) ** 2
    gained = cost - equations.cost + float(prior @ nearer)
    if gained > 0.0:
        after = State(
            values,
            starts,
            equations,
            kept,
            stale=task.keeps > 0,
            damping=_after_gain(state.damping, gained, expected),
        )
    else:
        after = _damped(state, astray=not equations.cost < ASTRAY * cost)
    if after.end is None and after.stale and not (gained > FAIR_GAIN * expected and gained > 0.0):
        return renewed(objective, after) or replace(after, end=End.RAN_AWAY)
    return after


def renewed(objective: Objective, state: State) -> State | None:
    """The state with derivatives taken where it is, None where a rollout runs away there."""
    equations, kept = objective.rollouts.evaluate(objective.task, state.values, state.starts)
    if not np.isfinite(equations.cost):
        return None
    return replace(state, equations=equations, derivatives=kept, stale=False)


def _after_gain(damping: float, gained: float, expected: float) -> float:
    """The damping after a step that gained."""
    if gained > FULL_GAIN * expected:
        damping *= SHRINK_FAST
    elif gained > FAIR_GAIN * expected:
        damping *= SHRINK
    return max(damping, LEAST_DAMPING)


def _damped(state: State, *, astray: bool) -> State:
    """The state after a step that gained nothing. With stale derivatives the damping stays, for
    those are taken anew first."""
    damping = state.damping
    damping *= GROW_FAST if astray else 1.0 if state.stale else GROW
    end = End.CONVERGED if damping > MOST_DAMPING else None
    return replace(state, damping=damping, astray=astray, end=end)
