"""Lanes: what a fit asks of blocks of rollouts, and how parameter vectors lie in them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueup.fit.free_numbers import Free
from trueup.fit.rollout_fit import Start
from trueup.model.block import Block
from trueup.model.hypothesis import Hypothesis
from trueup.model.series import RolloutOf, Series

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Task:
    """What is fitted to what.

    `states` are the hidden ones whose past is estimated. Derivatives by the first `keeps` free
    numbers may be kept from one step to the next.
    """

    data: Sequence[Series]
    hypothesis: Hypothesis
    free: Free
    states: tuple[tuple[str, str], ...]
    keeps: int


@dataclass(frozen=True, slots=True)
class Lanes:
    """Parameter vectors `p` `(rows, lanes)` and the `inverse` of each lane's step `(lanes,)`.

    Lane 0 is unperturbed; `starts` lanes of windows' starts follow it, then the lanes `of` numbers,
    memories and what is screened. `against` are the lanes that their differences are taken from.
    """

    p: Array
    inverse: Array
    of: NDArray[np.int64]
    starts: int
    against: NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class LaidOut:
    """An episode's lanes: its parameter vectors `p` `(rows, lanes)`, the inverse of each lane's
    step `(lanes,)`, from where windows start `(windows, 2 x joints, lanes)`, and by which `steps`
    `(windows, 2 x joints)` lanes of starts differ, which may be the episode's own."""

    series: Series
    p: Array
    inverse: Array
    init: Array
    steps: Array
    own_steps: bool
    starts: int

    @staticmethod
    def of(
        lanes: Lanes,
        s: Series,
        start: Start,
        pasts: Mapping[tuple[str, str], tuple[int, float]],
        block: Block,
        usual: Array,
        keeps: int,
    ) -> LaidOut:
        """The lanes of an episode: its own hidden states' past, and from where its windows start.

        `pasts` are the lanes and steps of hidden states' derivatives; `usual` `(2 x joints,)` the
        steps of starts, which are the episode's own where no derivatives are kept.
        """
        p, inverse = lanes.p.copy(), lanes.inverse.copy()
        for key, value in start.memory.items():
            p[block.memories[key]] += value
        for key, (lane, size) in pasts.items():
            inwards = -size if start.memory.get(key, 0.0) > 0.0 else size
            p[block.memories[key], lane] += inwards
            inverse[lane] = 1.0 / inwards
        init = np.repeat(start.windows[:, :, None], p.shape[1], axis=2)
        own = None if keeps else start.steps
        steps = np.broadcast_to(usual, start.windows.shape) if own is None else own
        return LaidOut(s, p, inverse, init, steps, own is not None, lanes.starts)

    def rollout(self, from_starts: bool) -> RolloutOf:
        """The rollout of these lanes, with lanes of starts, or with none."""
        if not from_starts:
            return RolloutOf(self.series, self.p, self.init)
        init = self.init.copy()
        for state in range(self.starts):
            init[:, state, 1 + state] += self.steps[:, state]
        return RolloutOf(self.series, self.p, init, starts=self.starts)
