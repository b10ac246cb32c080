"""Multiple shooting: what the windows of a rollout fit start from, estimated beside its numbers.

A window's start is known from a noisy sample, or not observed at all. It is estimated with
everything else fixed: by Levenberg-Marquardt with a damping of each window's own, and among starts
around it where descent ends in a valley of its own. Source: H. G. Bock, Recent Advances in
Parameter Identification Techniques for O.D.E. (1983).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from trueup.fit.levenberg_marquardt import NEGLIGIBLE
from trueup.fit.normal_equations import NOTHING, RAN_AWAY, NormalEquations
from trueup.fit.rollout_fit import TWO_SIDED, RolloutFit, Start
from trueup.fit.rollouts import START_STEP, Rollouts
from trueup.model.block import BLOCK
from trueup.model.hypothesis import Hypothesis, switches
from trueup.model.roll import roll_parts
from trueup.model.rounding import rounded
from trueup.model.series import Series
from trueup.model.stack import Part, RolloutOf, Stack

Array = NDArray[np.float64]
TOLERANCE = 1e-4  # of the cost: a smaller decrease ends the estimate
SCATTERED = 3.0  # standard deviations of noise: how far around an observed state others are tried
UNSEEN_SCATTERED = 0.3  # of a scale: the reach where a state was not observed
CLOSER = 0.4  # times, from one start that is tried to the next
SWING = 0.5  # of a half-width with all else fixed, to either side: what the data can tell
FINEST = 1e-3  # of a start's step, where its effect grows a thousandfold before the window ends


def estimate_starts(
    rollouts: Rollouts,
    data: Sequence[Series],
    hypothesis: Hypothesis,
    values: Array,
    starts: Mapping[str, Start] | None = None,
    iterations: int = 12,
    tolerance: float = TOLERANCE,
    *,
    fine: bool = False,
) -> RolloutFit:
    """What the windows start from, with the numbers `values` fixed.

    Windows know nothing of each other but through what hidden states remember. Where `fine`,
    differences are as wide as the log can tell.
    """
    task = rollouts.task(data, hypothesis, rollouts.free(hypothesis).none())
    now, converged = rollouts.initial_starts(starts, data, hypothesis), False
    best, _ = rollouts.evaluate(task, values, now)
    samples, stack = rollouts.samples(data), task.stack
    damping = np.full(len(best.sums), 1e-3)
    for _ in range(iterations):
        moves = best.moves(damping)
        now = _with_steps(rollouts, stack, now, best, samples) if fine else now
        tried = task.moved(now, moves)
        after, _ = rollouts.evaluate(task, values, tried)
        better = after.window_costs <= best.window_costs * (1.0 + tolerance) + NEGLIGIBLE
        damping = damping * np.where(better, 0.1, 10.0)
        if not better.all():
            gained = after.episode_costs < best.episode_costs
            for key, of, gains in zip(stack.digests, stack.split(better), gained, strict=True):
                windows = np.where(of[:, None], tried[key].windows, now[key].windows)
                memory = tried[key].memory if gains else now[key].memory
                tried[key] = replace(tried[key], windows=windows, memory=memory)
            if rollouts.forgets(hypothesis):
                after = best.mixed(after, better)
            else:
                after, _ = rollouts.evaluate(task, values, tried)
        before = best.cost
        gaining = after.episode_costs < best.episode_costs
        gained_in = dict(zip(stack.digests, gaining, strict=True))
        now = {key: tried[key] if gained_in[key] else now[key] for key in now}
        best = best.mixed(after, gaining[stack.episode_of])
        small = not before - best.cost > tolerance * best.cost + NEGLIGIBLE
        settled = bool(np.isfinite(before)) and small
        converged = settled and bool(better.all())
        if converged or (not gaining.any() and (settled or not np.isfinite(before))):
            break
    costs = best.window_costs
    return RolloutFit(
        hypothesis,
        values,
        task.free,
        now,
        best.cost,
        costs,
        samples,
        np.zeros((0, 0)),
        converged,
        np.zeros((len(costs), 0)),
    )


def best_of_scattered(
    rollouts: Rollouts,
    data: Sequence[Series],
    hypothesis: Hypothesis,
    values: Array,
    starts: Mapping[str, Start],
) -> dict[str, Start]:
    """The best start of each window of one joint, among starts around its own, one in each lane:
    descent of a start ends in the nearest valley.

    Those of a state go as far as SCATTERED standard deviations of its noise, of one that was not
    observed as its scale. Several joints have too many, and stay where they are.
    """
    observed = np.isfinite(rollouts.sigma)
    free = np.flatnonzero(~observed if rollouts.held else np.ones(2 * rollouts.joints, np.bool_))
    sizes = (BLOCK - 1) // 2 // max(len(free), 1)
    if rollouts.joints > 1 or not sizes:
        return dict(starts)
    unseen = UNSEEN_SCATTERED / START_STEP * rollouts.start_steps
    reach = np.where(observed, SCATTERED * rollouts.sigma, unseen)
    lanes = np.zeros((BLOCK, 2 * rollouts.joints))
    for i, state in enumerate(free):
        ladder = reach[state] * CLOSER ** np.arange(sizes)
        around = slice(1 + 2 * sizes * i, 1 + 2 * sizes * (i + 1))
        lanes[around, state] = np.concatenate([ladder, -ladder])
    stack = Stack.of(data)
    p = np.stack([rollouts.repeated(values, starts[digest]) for digest in stack.digests])
    init = np.concatenate([starts[d].windows for d in stack.digests])[:, :, None] + lanes.T
    asked = RolloutOf(stack, p, init, starts=BLOCK - 1)
    errors, costs = rollouts.errors(stack, hypothesis, p[-1, :, 0]), np.zeros((len(init), BLOCK))

    def add(part: Part, out: Array) -> None:
        with np.errstate(over="ignore", invalid="ignore"):
            errors.add_costs(part, out, costs)

    roll_parts(rollouts.form, switches(hypothesis, rollouts.joints), asked, add)
    costs = np.nan_to_num(costs, nan=RAN_AWAY, posinf=RAN_AWAY)
    best = np.argmin(rounded(costs), axis=1)
    chosen = {}
    for s, costs_here, best_here in zip(data, stack.split(costs), stack.split(best), strict=True):
        start, usual = starts[s.digest], costs_here[:, 0]
        of_a_sample = usual.sum() / max(rollouts.samples([s]), 1)
        better = usual - costs_here.min(axis=1) > max(1.0, of_a_sample)
        by = np.where(better[:, None], lanes[best_here], 0.0)
        chosen[s.digest] = replace(start, windows=start.windows + by)
    return chosen


def _with_steps(
    rollouts: Rollouts,
    stack: Stack,
    starts: Mapping[str, Start],
    equations: NormalEquations,
    samples: int,
) -> dict[str, Start]:
    """Starts with difference steps that are half a half-width of each by itself, no longer than the
    usual ones."""
    if not np.isfinite(equations.cost):
        return dict(starts)
    half = SWING * TWO_SIDED * np.sqrt(max(equations.cost / samples, 1.0))
    longest = rollouts.start_steps
    power = np.diagonal(equations.sums, axis1=1, axis2=2)[:, -2 * rollouts.joints :]
    steps = np.clip(half / np.sqrt(np.maximum(power, NOTHING)), FINEST * longest, longest)
    by_episode = zip(stack.digests, stack.split(np.asarray(rounded(steps))), strict=True)
    return {key: replace(starts[key], steps=own) for key, own in by_episode}
