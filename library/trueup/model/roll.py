"""Roll: what a hypothesis makes of recorded episodes, by the compiled rollout or, of a simulator of
the user's own, in numpy."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from trueup.cores import in_parallel
from trueup.model.block import BLOCK, FILTERS
from trueup.model.dynamics import Form
from trueup.model.series import Series
from trueup.model.stack import Part, RolloutOf, Stack

Array = NDArray[np.float64]
T = TypeVar("T")


def roll(
    s: Series,
    form: Form,
    p: Array,
    on: NDArray[np.uint8],
    init: Array,
    starts: int = 0,
) -> Array:
    """Rollout of blocks of lanes over one series, `(samples, 2 x joints, lanes)`; arguments as in
    `RolloutOf` of one episode, whole blocks of lanes."""
    of = RolloutOf(Stack.of([s]), p[None], init, starts=starts)
    return roll_parts(form, on, of, lambda _, out: out)[0]


def roll_parts(
    form: Form,
    on: NDArray[np.uint8],
    of: RolloutOf,
    then: Callable[[Part, Array], T],
    *,
    alone: bool = False,
    in_threads: bool = False,
) -> list[T]:
    """What `then` makes of the rollouts `(samples, 2 x joints, lanes)` of parts of a stack, in
    order; of each episode `alone`, or `in_threads`.

    Compiled ones are made one by one, each forgotten once it was used, or in threads; those of a
    simulator all at once.
    """
    stack = of.stack
    numbers = stack.observed.shape[1] * of.p.shape[2]
    if form.simulator is not None:
        from trueup.model.simulator.rollout import roll_simulator  # noqa: PLC0415  (seldom needed)

        rolled = roll_simulator(form.simulator, form.sizes, form.block, on, of)
        parts = stack.parts(numbers, alone=alone)
        return [then(part, np.concatenate(rolled[part.first : part.end])) for part in parts]

    def one(part: Part) -> T:
        return then(part, _compiled(form, on, of, part))

    if in_threads:
        return list(in_parallel(one, list(stack.parts(numbers, alone=True))))
    return [one(part) for part in stack.parts(numbers, alone=alone)]


def _compiled(form: Form, on: NDArray[np.uint8], of: RolloutOf, part: Part) -> Array:
    from trueup.model.kernel import kernel  # noqa: PLC0415  (numba loads slowly; a server that only serves needs none)

    s, gains, episodes, samples = of.stack, of.gains, slice(part.first, part.end), part.samples
    init = of.init if gains is None else of.init[episodes]
    joints, lanes = s.observed.shape[1] // 2, of.p.shape[2]
    count = samples.stop - samples.start
    out = np.empty((count, 2 * joints, lanes))
    observed = s.observed[samples]
    # filters that nobody asked for are like the last one
    if gains is None:
        followed = np.zeros((1, joints, 4, 2, FILTERS))
    else:
        followed = np.take(gains, np.minimum(np.arange(FILTERS), gains.shape[-1] - 1), axis=-1)
        observed = np.where(s.usable[samples], observed, np.nan)
    ends = s.ends[part.first : part.end + 1] - samples.start
    for first in range(0, lanes, BLOCK):
        some = slice(first, first + BLOCK)
        block = out if lanes == BLOCK else np.empty((count, 2 * joints, BLOCK))
        kernel()(
            np.ascontiguousarray(of.p[episodes, :, some]), on, form.block.nominal, form.family,
            form.tree, form.sizes, s.scheme.alpha, s.series[0].u_scale, s.periods_s[episodes], ends,
            s.t_s[samples], s.h_s[samples], s.steps[samples], s.issued[samples], s.rise[samples],
            s.integral[samples], s.resets[samples], np.ascontiguousarray(init[:, :, some]),
            0 if first else min(of.starts, BLOCK - 1), gains is not None, followed, observed, block,
        )  # fmt: skip
        if block is not out:
            out[:, :, some] = block
    return out
