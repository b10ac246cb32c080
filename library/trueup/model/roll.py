"""Roll: what a hypothesis makes of recorded episodes, by the compiled rollout or, of a simulator of
the user's own, in numpy."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from trueup.cores import in_parallel
from trueup.model.block import BLOCK, FILTERS
from trueup.model.dynamics import Form
from trueup.model.series import RolloutOf, Series

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
    `RolloutOf`, whole blocks of lanes."""
    return roll_each(form, on, [RolloutOf(s, p, init, starts=starts)], lambda _, out: out)[0]


def roll_each(
    form: Form,
    on: NDArray[np.uint8],
    asked: Sequence[RolloutOf],
    then: Callable[[int, Array], T],
    *,
    in_threads: bool = False,
) -> list[T]:
    """What `then` makes of each rollout, which it gets with its number.

    Compiled ones are made one by one, each forgotten once it was used, or `in_threads`; those of a
    simulator all at once.
    """
    if form.simulator is not None:
        from trueup.model.simulator.rollout import roll_simulator  # noqa: PLC0415  (seldom needed)

        rolled = roll_simulator(form.simulator, form.sizes, form.block, on, asked)
        return [then(i, out) for i, out in enumerate(rolled)]

    def one(i: int) -> T:
        return then(i, _compiled(form, on, asked[i]))

    return list((in_parallel if in_threads else map)(one, range(len(asked))))


def _compiled(form: Form, on: NDArray[np.uint8], of: RolloutOf) -> Array:
    from trueup.model.kernel import kernel  # noqa: PLC0415  (numba loads slowly; a server that only serves needs none)

    s, gains = of.series, of.gains
    joints, lanes = len(s.u_scale), of.p.shape[1]
    out = np.empty((len(s.t_s), 2 * joints, lanes))
    observed = np.where(s.usable, s.observed, np.nan) if gains is not None else s.observed
    # filters that nobody asked for are like the last one
    followed = (
        np.zeros((1, joints, 4, 2, FILTERS))
        if gains is None
        else np.take(gains, np.minimum(np.arange(FILTERS), gains.shape[-1] - 1), axis=-1)
    )
    for first in range(0, lanes, BLOCK):
        some = slice(first, first + BLOCK)
        part = out if lanes == BLOCK else np.empty((len(s.t_s), 2 * joints, BLOCK))
        kernel()(
            np.ascontiguousarray(of.p[:, some]), on, form.block.nominal, form.family, form.tree,
            form.sizes, s.scheme.alpha, s.u_scale,
            s.period_s, s.t_s, s.h_s, s.steps, s.issued, s.rise, s.integral, s.resets,
            np.ascontiguousarray(of.init[:, :, some]),
            0 if first else min(of.starts, BLOCK - 1), gains is not None, followed, observed, part,
        )  # fmt: skip
        if part is not out:
            out[:, :, some] = part
    return out
