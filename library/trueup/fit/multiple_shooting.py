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
from trueup.model.roll import roll_each
from trueup.model.rounding import rounded
from trueup.model.series import RolloutOf, Series

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
    samples = rollouts.samples(data)
    damping = {key: np.full(len(g), 1e-3) for key, g in best.parts.items()}
    for _ in range(iterations):
        moves = best.moves(damping)
        now = _with_steps(rollouts, now, best, samples) if fine else now
        tried = {key: now[key].moved(*move, task.states) for key, move in moves.items()}
        after, _ = rollouts.evaluate(task, values, tried)
        better = {
            key: after.costs(key) <= best.costs(key) * (1.0 + tolerance) + NEGLIGIBLE for key in now
        }
        damping = {key: damping[key] * np.where(of, 0.1, 10.0) for key, of in better.items()}
        if not all(of.all() for of in better.values()):
            for key, of in better.items():
                gained = after.cost_of(key) < best.cost_of(key)
                windows = np.where(of[:, None], tried[key].windows, now[key].windows)
                memory = tried[key].memory if gained else now[key].memory
                tried[key] = replace(tried[key], windows=windows, memory=memory)
            if rollouts.forgets(hypothesis):
                after = best.mixed(after, better)
            else:
                after, _ = rollouts.evaluate(task, values, tried)
        before = best.cost
        gaining = [key for key in now if after.cost_of(key) < best.cost_of(key)]
        now = {**now, **{key: tried[key] for key in gaining}}
        best = best.mixed(after, {key: np.ones(len(better[key]), np.bool_) for key in gaining})
        small = not before - best.cost > tolerance * best.cost + NEGLIGIBLE
        settled = bool(np.isfinite(before)) and small
        converged = settled and all(of.all() for of in better.values())
        if converged or (not gaining and (settled or not np.isfinite(before))):
            break
    costs = np.concatenate([best.costs(key) for key in now])
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
    asked = [
        RolloutOf(
            s,
            rollouts.repeated(values, starts[s.digest]),
            starts[s.digest].windows[:, :, None] + lanes.T,
            starts=BLOCK - 1,
        )
        for s in data
    ]

    def chosen_of(i: int, out: Array) -> Start:
        s, start = data[i], starts[data[i].digest]
        with np.errstate(over="ignore", invalid="ignore"):
            errors = rollouts.errors(s, hypothesis, asked[i].p[:, 0])
            costs = errors.costs(out, len(start.windows))
            costs = np.nan_to_num(costs, nan=RAN_AWAY, posinf=RAN_AWAY)
        best = np.argmin(rounded(costs), axis=1)
        of_a_sample = costs[:, 0].sum() / max(rollouts.samples([s]), 1)
        better = costs[:, 0] - costs.min(axis=1) > max(1.0, of_a_sample)
        by = np.where(better[:, None], lanes[best], 0.0)
        return replace(start, windows=start.windows + by)

    on = switches(hypothesis, rollouts.joints)
    chosen = roll_each(rollouts.form, on, asked, chosen_of)
    return {s.digest: start for s, start in zip(data, chosen, strict=True)}


def _with_steps(
    rollouts: Rollouts, starts: Mapping[str, Start], equations: NormalEquations, samples: int
) -> dict[str, Start]:
    """Starts with difference steps that are half a half-width of each by itself, no longer than the
    usual ones."""
    if not np.isfinite(equations.cost):
        return dict(starts)
    half = SWING * TWO_SIDED * np.sqrt(max(equations.cost / samples, 1.0))
    longest = rollouts.start_steps
    wide = {}
    for key, start in starts.items():
        power = np.diagonal(equations.parts[key], axis1=1, axis2=2)[:, -2 * rollouts.joints :]
        steps = np.clip(half / np.sqrt(np.maximum(power, NOTHING)), FINEST * longest, longest)
        wide[key] = replace(start, steps=np.asarray(rounded(steps)))
    return wide
