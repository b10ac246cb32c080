"""Convergence: a fit taken to the minimum of its cost, the proof that it is there, and the other
minima that the data allow.

At a minimum that counts, half an interval to either side costs the same. So the gradient is a
difference of costs as far apart as the data can tell, not at one part in ten thousand, where each
joint that sticks or slips makes a kink of its own. With the curvature of the normal equations it
gives the step to the minimum; the fit is there when that step would move no estimate by more than
PROVEN of its half-width. The last few places and their steps tell where steps vanish, and lead
there sooner than each step by itself.

A cost is a function of the numbers alone once what windows start from is at rest. Such a start has
valleys of its own, so others around it are tried at every look.

Descents begin where the search ended, and far to either side along the direction that the data
determine least. Minima that cost no more than a likelihood-ratio test tells from the best are all
kept. Source: W. Q. Meeker, L. A. Escobar, The American Statistician 49 (1995), on intervals by
likelihood ratios; A. H. Ribeiro et al., Automatica 121 (2020), on how the length of windows makes
costs smooth or rough.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from trueup.fit.fitter import Fitter
from trueup.fit.free_numbers import Free
from trueup.fit.levenberg_marquardt import PRIOR
from trueup.fit.multiple_shooting import SWING, best_of_scattered, estimate_starts
from trueup.fit.rollout_fit import PROVEN, TWO_SIDED, RolloutFit, Start
from trueup.fit.rollouts import CentralDifferences
from trueup.model.rounding import rounded
from trueup.model.series import Series

Array = NDArray[np.float64]
TINY = 1e-300  # what is divided by at least
WIDEST_SWING = 0.25  # of a number's range: the longest difference
NEAR = 1.0  # half-widths from the minimum: from there on each look is as wide as the last
MOST_LOOKS = 30  # at a step
PATIENCE = 6  # steps that come no nearer
FURTHEST = 3.0  # half-widths in one step
SLACK = 1.0  # times what is left of a sample: a cost that rises by less has not risen
REMEMBERED = 3  # steps that tell what the normal equations neglect
ALIKE = 1e-2  # of the largest singular value: what tells less of a step is left out
SHORTEST = 0.02  # of a step
START_ITERATIONS = 6  # for what windows start from
START_TOLERANCE = 1e-7  # of the cost: a smaller decrease ends them
# times the curvature of the normal equations: what they neglect is no more
SOFTEST, STIFFEST = 0.25, 4.0
RIDGE = 1e-12  # of a determined direction's curvature
DISPLACED = 4.0  # half-widths along the direction that is determined least
DESCENT = 8  # iterations from there
DISTINCT = TWO_SIDED**2  # times what is left of a sample: a minimum that costs more is worse
SAME_MINIMUM = 0.1  # of a half-width: minima that are nearer are one

Fixed = Iterable[tuple[str, str]]


def minima(
    fitter: Fitter, data: Sequence[Series], fit: RolloutFit, fixed: Fixed = ()
) -> list[RolloutFit]:
    """The minima that the data do not tell from the best, the best first, from a fit and from far
    to both of its sides.

    Where no minimum can be proven near the fit, the cost is too rough for any, and it is all that
    is looked for.
    """
    fixed = list(fixed)
    converged = [converge(fitter, data, fit, fixed)]
    for values in _far_starts(converged[0]) if converged[0].proven else ():
        descended = fitter.fit(
            data, fit.hypothesis, values, converged[0].starts, iterations=DESCENT, fixed=fixed
        )
        if descended.cost < converged[0].cost + FURTHEST * DISTINCT * _residual_variance(
            converged[0]
        ):
            converged.append(converge(fitter, data, descended, fixed))
    converged.sort(key=lambda f: f.cost)
    alike = [
        f
        for f in converged
        if f.cost <= converged[0].cost + DISTINCT * _residual_variance(converged[0])
    ]
    return [
        f for i, f in enumerate(alike) if not any(_same_minimum(f, other) for other in alike[:i])
    ]


def converge(
    fitter: Fitter,
    data: Sequence[Series],
    fit: RolloutFit,
    fixed: Fixed = (),
    most: int = MOST_LOOKS,
) -> RolloutFit:
    """A fit's minimum, from where it ended, by so many looks at most. Numbers that are `fixed`
    stay."""
    free = fitter.free(fit.hypothesis, fixed)
    values, starts = fit.values, _starts_at_rest(fitter, data, fit, fit.values, np.inf, fit.starts)
    best = _examined(fitter, data, fit, values, starts, free)
    # now as far apart as the data tell
    best = _examined(fitter, data, fit, values, starts, best.free)
    part, distances, path = 1.0, [best.distance], [(free.at(values), best.step)]
    nearest = best, values, starts
    for _ in range(most):
        nearer = len(distances) <= PATIENCE or min(distances[-PATIENCE:]) < min(
            distances[:-PATIENCE]
        )
        if best.distance <= PROVEN or not nearer or part < SHORTEST or not np.isfinite(best.cost):
            break
        step = rounded(
            _accelerated_step(path, best)
            if part == 1.0
            else part * min(1.0, FURTHEST / best.distance) * best.step
        )
        tried = free.moved(values, step)
        led = best.around.moved(starts, step)
        there = _starts_at_rest(fitter, data, fit, tried, best.cost, led, starts)
        after = _examined(fitter, data, fit, tried, there, best.free)
        if after.cost > best.cost + SLACK * best.cost / fit.samples:
            part *= 0.5
            continue
        known = path[-REMEMBERED:] if best.distance < FURTHEST else []
        values, starts, best, part = tried, there, after, 1.0
        path = [*known, (free.at(values), best.step)]
        distances.append(best.distance)
        if (
            best.distance < nearest[0].distance
            or best.cost < nearest[0].cost - SLACK * best.cost / fit.samples
        ):
            nearest = best, values, starts
    best, values, starts = nearest
    equations = best.around.equations
    if not np.isfinite(equations.cost):
        return replace(fit, converged=False, distance=np.inf)
    return replace(
        fit,
        values=values,
        free=free,
        starts=starts,
        cost=equations.cost,
        costs=equations.sums[:, 0, 0].copy(),
        information=best.normal,
        scores=equations.reduced_with_scores()[1],
        converged=best.distance <= PROVEN,
        distance=best.distance,
    )


@dataclass(frozen=True, slots=True)
class _Place:
    """A place with the step from it to the minimum, `(free,)`, and how far that is in half-widths;
    `free` has the steps of the differences to be taken next.
    """

    around: CentralDifferences
    cost: float
    normal: Array
    step: Array
    distance: float
    free: Free


def _examined(
    fitter: Fitter,
    data: Sequence[Series],
    fit: RolloutFit,
    values: Array,
    starts: Mapping[str, Start],
    free: Free,
) -> _Place:
    """What a look to both sides of each number shows."""
    around, n = fitter.around(data, fit.hypothesis, values, starts, free), len(free.rows)
    cost = around.equations.cost
    if not np.isfinite(cost) or not n:
        return _Place(around, cost, np.zeros((n, n)), np.zeros(n), np.inf if n else 0.0, free)
    reduced_chi_square, at = max(cost / fit.samples, 1.0), free.at(values)
    ratio = np.where(np.isfinite(around.curvature), around.curvature, around.diagonal) / np.maximum(
        around.diagonal, TINY
    )
    stiff = np.sqrt(np.clip(ratio, SOFTEST, STIFFEST))
    weight, centre = fitter.expected(free)
    worth = PRIOR * reduced_chi_square * weight
    normal = around.equations.reduced()[0] * stiff[:, None] * stiff
    step, error = _step_to_minimum(
        normal + np.diag(worth),
        around.gradient + worth * (centre - at),
        at <= free.low,
        at >= free.high,
    )
    with np.errstate(over="ignore"):  # what nothing determines swings without end
        variance = reduced_chi_square / np.maximum(around.diagonal + worth, TINY)
    swing = SWING * TWO_SIDED * np.sqrt(variance)
    reach = np.where(
        np.isfinite(free.high - free.low), WIDEST_SWING * (free.high - free.low), np.inf
    )
    distance = float(np.max(np.abs(step) / (TWO_SIDED * np.sqrt(reduced_chi_square) * error)))
    if not (free.central and distance < NEAR):
        free = replace(free, step=np.asarray(rounded(np.minimum(swing, reach))), central=True)
    return _Place(around, cost, normal, step, distance, free)


def _accelerated_step(path: Sequence[tuple[Array, Array]], best: _Place) -> Array:
    """A step to where steps vanish, by what the last places and their steps tell, `(free,)`; no
    longer than FURTHEST.

    Source: D. G. Anderson, Journal of the ACM 12 (1965); H. F. Walker, P. Ni, SIAM Journal on
    Numerical Analysis 49 (2011).
    """
    step = best.step
    if len(path) > 1:
        at, steps = (np.array(x).T for x in zip(*path, strict=True))
        size = np.sqrt(np.diag(best.normal))[:, None]
        over, turned = np.diff(at), np.diff(steps)
        part = np.linalg.lstsq(size * turned, size[:, 0] * step, rcond=ALIKE)[0]
        step = step - (over + turned) @ part
    length = best.distance * np.sqrt(
        float(step @ best.normal @ step) / max(float(best.step @ best.normal @ best.step), TINY)
    )
    return np.asarray(min(1.0, FURTHEST / length) * step)


def _step_to_minimum(
    normal: Array, gradient: Array, lowest: NDArray[np.bool_], highest: NDArray[np.bool_]
) -> tuple[Array, Array]:
    """The step to where a quadratic cost is least, no further than to bounds where numbers are, and
    each one's standard error for a reduced_chi_square of 1, `(free,)` each.
    """
    free = np.diag(normal) > 0.0
    while True:
        step, error = np.zeros(len(normal)), np.full(len(normal), np.inf)
        if free.any():
            part = normal[np.ix_(free, free)]
            size = np.sqrt(np.diag(part))
            inverse = (
                np.linalg.inv(part / size[:, None] / size + RIDGE * np.eye(len(size)))
                / size[:, None]
                / size
            )
            step[free], error[free] = inverse @ gradient[free], np.sqrt(np.abs(np.diag(inverse)))
        outwards = free & ((lowest & (step < 0.0)) | (highest & (step > 0.0)))
        if not outwards.any():
            return step, error
        free &= ~outwards


def _starts_at_rest(
    fitter: Fitter,
    data: Sequence[Series],
    fit: RolloutFit,
    values: Array,
    cost: float,
    *beginnings: Mapping[str, Start],
) -> dict[str, Start]:
    """What each episode's windows start from, at rest: from the first of some beginnings, from the
    next where that cost more than before, and from what lies around the best.
    """
    at_rest = partial(
        estimate_starts,
        fitter,
        data,
        fit.hypothesis,
        values,
        iterations=START_ITERATIONS,
        tolerance=START_TOLERANCE,
        fine=True,
    )
    best = at_rest(starts=beginnings[0])
    for starts in beginnings[1:]:
        best = _cheaper_by_episode(best, at_rest(starts=starts)) if best.cost > cost else best
    around = best_of_scattered(fitter, data, fit.hypothesis, values, best.starts)
    if any((around[key].windows != best.starts[key].windows).any() for key in around):
        best = _cheaper_by_episode(best, at_rest(starts=around))
    return dict(best.starts)


def _cheaper_by_episode(one: RolloutFit, other: RolloutFit) -> RolloutFit:
    """A fit with the starts of the one or the other, by episode those that cost less."""
    ours, its = one.by_episode, other.by_episode
    starts = {key: (one if ours[key] <= its[key] else other).starts[key] for key in one.starts}
    return replace(one, starts=starts, cost=sum(min(ours[key], its[key]) for key in starts))


def _far_starts(fit: RolloutFit) -> list[Array]:
    """Values far to both sides along the direction that the data determine least, measured by each
    number's own curvature."""
    shown = np.diag(fit.information) > 0.0
    if not shown.any():
        return []
    size = np.sqrt(np.diag(fit.information)[shown])
    powers, ways = np.linalg.eigh(fit.information[np.ix_(shown, shown)] / size[:, None] / size)
    # an eigenvector's sign is nobody's
    way = ways[:, 0] * np.sign(ways[np.abs(rounded(ways[:, 0])).argmax(), 0])
    by = np.zeros(len(shown))
    by[shown] = (
        DISPLACED
        * TWO_SIDED
        * np.sqrt(_residual_variance(fit) / max(float(powers[0]), RIDGE))
        * way
        / size
    )
    return [fit.free.moved(fit.values, rounded(side * by)) for side in (1.0, -1.0)]


def _residual_variance(fit: RolloutFit) -> float:
    """What is left of a sample, noise at least."""
    return max(fit.reduced_chi_square, 1.0)


def _same_minimum(one: RolloutFit, other: RolloutFit) -> bool:
    """Whether two minima are one."""
    error = np.sqrt(_residual_variance(one) / np.maximum(np.diag(one.information), TINY))
    apart = np.abs(one.free.at(one.values) - other.free.at(other.values))
    return bool((apart < SAME_MINIMUM * TWO_SIDED * error).all())
