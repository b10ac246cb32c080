"""Lanes: what a fit asks of blocks of rollouts, and how parameter vectors lie in them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueup.fit.free_numbers import Free
from trueup.fit.normal_equations import Moves
from trueup.fit.rollout_fit import Start
from trueup.model.block import Block
from trueup.model.hypothesis import Hypothesis
from trueup.model.stack import RolloutOf, Stack

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Task:
    """What is fitted to what.

    `states` are the hidden ones whose past is estimated. Derivatives by the first `keeps` free
    numbers may be kept from one step to the next.
    """

    stack: Stack
    hypothesis: Hypothesis
    free: Free
    states: tuple[tuple[str, str], ...]
    keeps: int

    def moved(self, starts: Mapping[str, Start], moves: Moves) -> dict[str, Start]:
        """Where windows start after steps of starts and memories."""
        windows, memories = moves
        return {
            digest: starts[digest].moved(by, memory, self.states)
            for digest, by, memory in zip(
                self.stack.digests, self.stack.split(windows), memories, strict=True
            )
        }


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
    """The lanes of each episode: parameter vectors `p` `(episodes, rows, lanes)`, the inverse of
    each lane's step `(episodes, lanes)`, from where windows start `(windows, 2 x joints, lanes)`,
    and by which `steps` `(windows, 2 x joints)` lanes of starts differ, None where by the usual
    ones."""

    p: Array
    inverse: Array
    init: Array
    steps: Array | None

    @staticmethod
    def of(
        lanes: Lanes,
        stack: Stack,
        starts: Mapping[str, Start],
        pasts: Mapping[tuple[str, str], tuple[int, float]],
        block: Block,
        usual: Array,
        keeps: int,
    ) -> LaidOut:
        """The lanes of each episode: its own hidden states' past, and from where its windows start.

        `pasts` are the lanes and steps of hidden states' derivatives; `usual` `(2 x joints,)` the
        steps of starts, which are an episode's own where no derivatives are kept.
        """
        begins = [starts[digest] for digest in stack.digests]
        p = np.repeat(lanes.p[None], len(begins), axis=0)
        inverse = np.repeat(lanes.inverse[None], len(begins), axis=0)
        for e, start in enumerate(begins):
            for key, value in start.memory.items():
                p[e, block.memories[key]] += value
            for key, (lane, size) in pasts.items():
                inwards = -size if start.memory.get(key, 0.0) > 0.0 else size
                p[e, block.memories[key], lane] += inwards
                inverse[e, lane] = 1.0 / inwards
        windows = np.concatenate([start.windows for start in begins])
        init = np.repeat(windows[:, :, None], p.shape[2], axis=2)
        steps = None
        if not keeps and any(start.steps is not None for start in begins):
            steps = np.concatenate(
                [
                    np.broadcast_to(usual, start.windows.shape)
                    if start.steps is None
                    else start.steps
                    for start in begins
                ]
            )
        return LaidOut(p, inverse, init, steps)

    def rollout(self, stack: Stack, usual: Array, starts: int) -> RolloutOf:
        """The rollout of these lanes, with so many lanes of `starts`."""
        init = self.init
        if starts:
            init, at = init.copy(), np.arange(starts)
            init[:, at, 1 + at] += usual[:starts] if self.steps is None else self.steps[:, :starts]
        return RolloutOf(stack, self.p, init, starts=starts)
