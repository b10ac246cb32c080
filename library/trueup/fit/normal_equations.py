"""Normal equations of a rollout fit, from sums of outer products by window; what windows start from
is eliminated.

A row of a window's matrix is (error, directions and numbers, memories, start). Source: B. Triggs et
al., Bundle Adjustment (1999), 6.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from numba import njit
from numpy.typing import NDArray

from trueup.fit.blocks import inverses
from trueup.model.inverse import invert
from trueup.model.rounding import rounded

Array = NDArray[np.float64]
Moves = tuple[
    Array, Array
]  # of windows' starts `(windows, 2 x joints)`, of memories `(episodes, n)`
# of a sum of squares: no rollout that stays near its log comes there, and its own square is still
# finite
RAN_AWAY = 1e100
NOTHING = 1e-200  # of a squared derivative: what does no more than that has no step


@dataclass(frozen=True)
class NormalEquations:
    """Outer products of (error, parameter, memory and start derivatives), `sums` `(windows, used,
    used)`.

    Starts are eliminated window by window, then what hidden states `began` with `(episodes,
    states)` episode by episode; those have a prior of one of their `scales` `(states,)`.
    `window_ends` `(episodes + 1,)` are the first window of each episode, and the number of all.
    """

    sums: Array
    window_ends: NDArray[np.int64]
    began: Array
    scales: Array
    free: int

    @cached_property
    def cost(self) -> float:
        """Sum of squared normalised errors, infinite where a rollout ran away."""
        if not np.abs(self.sums).max(initial=0.0) < RAN_AWAY:
            return np.inf  # it ran away, or would a little further on
        errors = self.sums[:, 0, 0]
        prior = float(np.sum((self.began / self.scales) ** 2)) if self.began.size else 0.0
        return sum(float(errors[a:b].sum()) for a, b in pairwise(self.window_ends.tolist())) + prior

    @cached_property
    def window_costs(self) -> Array:
        """Cost of each window `(windows,)`, infinite where its rollout ran away."""
        with np.errstate(invalid="ignore"):
            sound = np.abs(self.sums).max(axis=(1, 2), initial=0.0) < RAN_AWAY
        return np.asarray(np.where(sound, self.sums[:, 0, 0], np.inf))

    @cached_property
    def episode_costs(self) -> Array:
        """Cost of each episode `(episodes,)`, infinite where a rollout ran away."""
        bounds, costs = pairwise(self.window_ends.tolist()), self.window_costs
        priors = np.sum((self.began / self.scales) ** 2, axis=1)
        return np.asarray(np.array([costs[a:b].sum() for a, b in bounds]) + priors)

    def mixed(self, other: NormalEquations, windows: NDArray[np.bool_]) -> NormalEquations:
        """These equations with the sums of some windows `(windows,)` from another place; what an
        episode's hidden states began with is from there where all of its windows are."""
        whole = np.array([windows[a:b].all() for a, b in pairwise(self.window_ends.tolist())])
        return replace(
            self,
            sums=np.where(windows[:, None, None], other.sums, self.sums),
            began=np.where(whole[:, None], other.began, self.began),
        )

    def moves(self, damping: Array) -> Moves:
        """Steps of starts and memories where no parameter moves, each window with a damping of its
        own `(windows,)`."""
        sound = np.where(np.isfinite(self.window_costs)[:, None, None], self.sums, 0.0)
        return replace(self, sums=sound)._condensed(damping).moves(np.zeros(0))

    def _condensed(self, damping: Array) -> _Condensed:
        """Starts eliminated window by window: matrices over (error, parameters, memories) by
        episode, with the memories' prior.

        `damping` `(windows,)` of all episodes; that of what an episode's hidden states began with
        is the least of its own.
        """
        n, m, windows = self.free, len(self.scales), len(self.sums)
        episodes = len(self.window_ends) - 1
        own = self.sums.shape[1] - (n + m + 1)
        inverse = np.empty((windows, own, own))
        cross = np.empty((windows, own, n + m + 1))
        total = np.zeros((episodes, n + m + 1, n + m + 1))
        _eliminate(self.sums, self.window_ends, n + m + 1, damping, inverse, cross, total)
        if not m:
            solve = np.zeros((episodes, 0, 0))
            return _Condensed(self.window_ends, inverse, cross, total, solve, total.sum(axis=0))
        weight = self.scales**-2
        bounds = pairwise(self.window_ends.tolist())
        least = np.array([damping[a:b].min(initial=np.inf) for a, b in bounds])
        at = np.arange(n + 1, n + m + 1)
        # a past that the episode does not show, as beyond a play's end, stays
        # where it is
        felt = total[:, at, at] > weight
        total[:, at, at] = (total[:, at, at] + weight) * (1.0 + least[:, None])
        pull = np.where(felt, weight * self.began, 0.0)
        total[:, 0, at] -= pull
        total[:, at, 0] -= pull
        solve = inverses(total[:, n + 1 :, n + 1 :])
        reduced = (
            total[:, : n + 1, : n + 1]
            - total[:, : n + 1, n + 1 :] @ solve @ total[:, n + 1 :, : n + 1]
        ).sum(axis=0)
        return _Condensed(self.window_ends, inverse, cross, total, solve, reduced)

    def reduced(self, damping: float = 0.0) -> tuple[Array, Array]:
        """Normal matrix and gradient of the parameters once starts and memories are eliminated."""
        total = self._condensed(self._alike(damping)).reduced
        return total[1:, 1:], total[0, 1:]

    def step(
        self, damping: float, at: Array, low: Array, high: Array, worth: Array, pull: Array
    ) -> tuple[Array, Moves, float]:
        """Steps of the parameters, which are `at` places between bounds and have a prior's normal
        diagonal `worth` and gradient `pull`, and of starts and memories, and the decrease that the
        linear model expects.
        """
        c, n = self._condensed(self._alike(damping)), self.free
        gradient, diagonal = c.reduced[0, 1:] + pull, np.diagonal(c.reduced)[1:] + worth
        moving = np.flatnonzero(
            ~(((at <= low) & (gradient < 0.0)) | ((at >= high) & (gradient > 0.0)))
            & (diagonal > NOTHING)
        )
        step = np.zeros(n)
        if len(moving):
            size = np.sqrt(diagonal[moving])
            scaled = c.reduced[1:, 1:][moving[:, None], moving] / size[:, None] / size
            # on the diagonal of what is scaled by it there are ones
            scaled.flat[:: len(size) + 1] = 1.0 + (damping + 1e-12)
            step[moving] = rounded(np.linalg.solve(scaled, gradient[moving] / size) / size)
        expected = float(step @ gradient) + c.expected(n)
        return step, c.moves(step), expected

    def moves_with(self, step: Array) -> Moves:
        """Steps of starts and memories beside a step of the parameters."""
        return self._condensed(self._alike(0.0)).moves(step)

    def reduced_with_scores(self) -> tuple[Array, Array]:
        """Normal matrix of the parameters, and each window's part of their gradient `(windows,
        parameters)`, both without what starts take up.
        """
        c, n = self._condensed(self._alike(0.0)), self.free
        taken = np.einsum("wi,wij,wjk->wk", c.cross[:, :, 0], c.inverse, c.cross[:, :, 1 : n + 1])
        return c.reduced[1:, 1:], np.asarray(self.sums[:, 0, 1 : n + 1] - taken)

    def _alike(self, damping: float) -> Array:
        return np.full(len(self.sums), damping)


@dataclass(frozen=True, slots=True)
class _Condensed:
    """Products of an elimination: `inverse` and `cross` of starts by window, `total` and `solve` of
    memories by episode."""

    window_ends: NDArray[np.int64]
    inverse: Array
    cross: Array
    total: Array
    solve: Array
    reduced: Array

    def moves(self, step: Array) -> Moves:
        """Steps of starts and memories beside a step of the parameters."""
        n, windows = len(step), np.empty(self.inverse.shape[:2])
        memory = np.zeros(self.solve.shape[:2])
        if memory.size:
            missing = self.total[:, n + 1 :, 0] - self.total[:, n + 1 :, 1 : n + 1] @ step
            memory = rounded(np.einsum("eij,ej->ei", self.solve, missing))
        _moved(self.inverse, self.cross, self.window_ends, step, memory, windows)
        return rounded(windows), memory

    def expected(self, free: int) -> float:
        """The decrease that starts and memories bring by themselves."""
        starts, memories = self.cross[:, :, 0], self.total[:, free + 1 :, 0]
        decrease = float(np.einsum("wi,wij,wj->", starts, self.inverse, starts))
        if memories.size:
            decrease += float(np.einsum("ei,eij,ej->", memories, self.solve, memories))
        return decrease


@njit(cache=True, nogil=True)
def _moved(inverse, cross, window_ends, step, memory, into):  # type: ignore[no-untyped-def]
    """Each window's step of its start, beside those of parameters and memories."""
    n, own = len(step), inverse.shape[1]
    missing = np.empty(own)
    for e in range(len(window_ends) - 1):
        for w in range(window_ends[e], window_ends[e + 1]):
            for i in range(own):
                missing[i] = cross[w, i, 0]
                for k in range(n):
                    missing[i] -= cross[w, i, 1 + k] * step[k]
                for k in range(memory.shape[1]):
                    missing[i] -= cross[w, i, 1 + n + k] * memory[e, k]
            for i in range(own):
                into[w, i] = 0.0
                for k in range(own):
                    into[w, i] += inverse[w, i, k] * missing[k]


@njit(cache=True, nogil=True, error_model="numpy")
def _eliminate(g, window_ends, size, damping, inverse, cross, total):  # type: ignore[no-untyped-def]
    """The Schur complement of each window's starting values, summed by episode."""
    own = g.shape[1] - size
    part, solved = np.empty((own, own)), np.empty((own, size))
    for e in range(len(window_ends) - 1):
        for w in range(window_ends[e], window_ends[e + 1]):
            ridge = 0.0
            for i in range(own):
                for k in range(own):
                    part[i, k] = g[w, size + i, size + k]
                part[i, i] *= 1.0 + damping[w]
                ridge += part[i, i]
            for i in range(own):
                part[i, i] += 1e-9 * max(ridge, 1e-3)
            invert(part, inverse[w])
            for i in range(own):
                for k in range(size):
                    cross[w, i, k] = g[w, size + i, k]
            for i in range(own):
                for k in range(size):
                    solved[i, k] = 0.0
                    for l in range(own):  # noqa: E741
                        solved[i, k] += inverse[w, i, l] * cross[w, l, k]
            for i in range(size):
                for k in range(size):
                    total[e, i, k] += g[w, i, k]
                    for l in range(own):  # noqa: E741
                        total[e, i, k] -= cross[w, l, i] * solved[l, k]
