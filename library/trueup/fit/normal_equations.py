"""Normal equations of a rollout fit: sums of outer products by window, what windows start from
eliminated.

A row of a window's matrix is (error, directions and numbers, memories, start). Derivatives that
hardly change from one step to the next, by the nominal form's directions and by the starts, may be
kept from an earlier rollout, and only the others are rolled out again. Source: B. Triggs et al.,
Bundle Adjustment (1999), 6; C. T. Kelley, Solving Nonlinear Equations with Newton's Method (2003),
section 2.4.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numba import njit
from numpy.typing import NDArray

from trueup.fit.blocks import inverses
from trueup.model.inverse import invert
from trueup.model.rounding import rounded

Array = NDArray[np.float64]
Lanes = NDArray[np.int64]
# of a sum of squares: no rollout that stays near its log comes there, and its own square is still
# finite
RAN_AWAY = 1e100
EVEN = 1e-3  # of a period: stamps that are so regular
NOTHING = 1e-200  # of a squared derivative: what does no more than that has no step


@dataclass(frozen=True, slots=True)
class KeptDerivatives:
    """Weighted derivatives of one episode's rollout by `first` directions and by the starts,
    `(samples, 2 x joints, kept)`, and the sums of their outer products by window `(windows, kept,
    kept)`.
    """

    rows: Array
    products: Array
    first: int


@dataclass(frozen=True, slots=True)
class Errors:
    """What a rollout is compared with, and what an error counts.

    `observed` and `weight` `(samples, 2 x joints)`, the inverse standard deviation of the noise, 0
    where nothing was seen; `window_of` the window that a sample is an error of; `t_s` `(samples,)`
    [s]. `correlation` `(2 x joints,)` is that of the noise with itself one `period_s` before:
    errors are taken less what the noise of the last one leads to expect. The first error of a
    window counts as it is. Source: D. Cochrane, G. H. Orcutt, Journal of the American Statistical
    Association 44 (1949); for the first error S. J. Prais, C. B. Winsten, Cowles Commission
    Discussion Paper 383 (1954).
    """

    observed: Array
    weight: Array
    window_of: NDArray[np.int64]
    t_s: Array
    period_s: float
    correlation: Array

    def _arguments(self) -> tuple[Array, Array, NDArray[np.int64], Array, float, Array]:
        return self.observed, self.weight, self.window_of, self.t_s, self.period_s, self.correlation

    def summed(
        self, out: Array, inverse: Array, lanes: Lanes, against: Lanes, windows: int
    ) -> Array:
        """Sums of outer products of (error, derivatives) by window, `(windows, 1 + derivatives, 1 +
        derivatives)`, of a rollout `(samples, 2 x joints, lanes)`.

        Its first lane is unperturbed; `lanes` are those of the derivatives, `against` which they
        are differences, `inverse` `(lanes,)` is that of each lane's step.
        """
        into = np.zeros((windows, 1 + len(lanes), 1 + len(lanes)))
        _summed(
            out, *self._arguments(), inverse, lanes, against, np.empty((*out.shape[:2], 0)), into
        )
        return into

    def kept(
        self, out: Array, inverse: Array, lanes: Lanes, sums: Array, first: int, start: int
    ) -> KeptDerivatives:
        """What is kept of a rollout and its sums: derivatives by the `first` numbers and by the
        start, whose columns begin at `start`."""
        columns = np.array([*range(1, first + 1), *range(start, sums.shape[1])])
        from_ = lanes[columns - 1]
        rows = np.zeros((*out.shape[:2], len(columns)))
        _derivatives(out, self.weight, inverse, from_, rows)
        products = np.ascontiguousarray(sums[:, columns[:, None], columns])
        return KeptDerivatives(rows, products, first)

    def renewed(self, out: Array, inverse: Array, lanes: Lanes, old: KeptDerivatives) -> Array:
        """Sums of outer products by window as `summed` gives them, of derivatives that were kept
        and the new ones of `lanes`."""
        (windows, many), fresh = old.products.shape[:2], len(lanes)
        ordered = np.zeros((windows, many + 1 + fresh, many + 1 + fresh))
        ordered[:, :many, :many] = old.products
        _summed(out, *self._arguments(), inverse, lanes, np.zeros_like(lanes), old.rows, ordered)
        # where the starts' begin; before them the new ones, and the error first of all
        behind = 1 + old.first + fresh
        at = np.array(
            [
                *range(1, old.first + 1),
                *range(behind, many + 1 + fresh),
                0,
                *range(1 + old.first, behind),
            ]
        )
        into = np.empty_like(ordered)
        into[:, at[:, None], at] = ordered
        return into

    def costs(self, out: Array, windows: int) -> Array:
        """Sums of squared errors of each window and lane of a rollout, `(windows, lanes)`."""
        costs = np.zeros((windows, out.shape[2]))
        _costs(out, *self._arguments(), costs)
        return costs


@dataclass(frozen=True)
class NormalEquations:
    """Outer products of (error, parameter, memory and start derivatives), by episode, `(windows,
    used, used)`.

    Starts are eliminated window by window, then what hidden states began with episode by episode;
    those have a prior of one scale.
    """

    parts: Mapping[str, Array]
    began: Mapping[str, Array]
    scales: Array
    free: int

    @cached_property
    def cost(self) -> float:
        """Sum of squared normalised errors, infinite where a rollout ran away."""
        if not all(np.abs(g).max(initial=0.0) < RAN_AWAY for g in self.parts.values()):
            return np.inf  # it ran away, or would a little further on
        prior = sum(float(np.sum((b / self.scales) ** 2)) for b in self.began.values())
        return sum(float(g[:, 0, 0].sum()) for g in self.parts.values()) + prior

    def costs(self, episode: str) -> Array:
        """Cost of each window of an episode, infinite where its rollout ran away."""
        g = self.parts[episode]
        with np.errstate(invalid="ignore"):
            sound = np.abs(g).max(axis=(1, 2), initial=0.0) < RAN_AWAY
        return np.where(sound, g[:, 0, 0], np.inf)

    def cost_of(self, episode: str) -> float:
        """Cost of an episode, infinite where a rollout ran away."""
        return float(self.costs(episode).sum() + np.sum((self.began[episode] / self.scales) ** 2))

    def mixed(
        self, other: NormalEquations, windows: Mapping[str, NDArray[np.bool_]]
    ) -> NormalEquations:
        """These equations with the parts of some windows, by episode, from another place; what an
        episode's hidden states began with is from there where all of its windows are."""
        parts, began = dict(self.parts), dict(self.began)
        for key, of in windows.items():
            parts[key] = np.where(of[:, None, None], other.parts[key], parts[key])
            began[key] = other.began[key] if of.all() else began[key]
        return replace(self, parts=parts, began=began)

    def moves(self, damping: Mapping[str, Array]) -> dict[str, tuple[Array, Array]]:
        """Steps of each episode's starts and memories where no parameter moves, each window with a
        damping of its own `(windows,)`."""
        sound = {
            key: np.where(np.isfinite(self.costs(key))[:, None, None], g, 0.0)
            for key, g in self.parts.items()
        }
        c = replace(self, parts=sound)._condensed(
            np.concatenate([damping[key] for key in self.parts])
        )
        return c.moves(list(self.parts), np.zeros(0))

    def _condensed(self, damping: Array) -> _Condensed:
        """Starts eliminated window by window: matrices over (error, parameters, memories) by
        episode, with the memories' prior.

        `damping` `(windows,)` of all episodes; that of what an episode's hidden states began with
        is the least of its own.
        """
        n, m = self.free, len(self.scales)
        sizes = [len(g) for g in self.parts.values()]
        stacked = np.concatenate(list(self.parts.values()))
        episode = np.repeat(np.arange(len(sizes)), sizes)
        own = stacked.shape[1] - (n + m + 1)
        inverse = np.empty((len(stacked), own, own))
        cross = np.empty((len(stacked), own, n + m + 1))
        total = np.zeros((len(sizes), n + m + 1, n + m + 1))
        _eliminate(stacked, episode, n + m + 1, damping, inverse, cross, total)
        if m:
            weight = self.scales**-2
            least = np.array([damping[episode == e].min(initial=np.inf) for e in range(len(sizes))])
            at = np.arange(n + 1, n + m + 1)
            # a past that the episode does not show, as beyond a play's end, stays
            # where it is
            felt = total[:, at, at] > weight
            total[:, at, at] = (total[:, at, at] + weight) * (1.0 + least[:, None])
            pull = np.where(felt, weight * np.array(list(self.began.values())), 0.0)
            total[:, 0, at] -= pull
            total[:, at, 0] -= pull
        solve = inverses(total[:, n + 1 :, n + 1 :])
        reduced = (
            total[:, : n + 1, : n + 1]
            - total[:, : n + 1, n + 1 :] @ solve @ total[:, n + 1 :, : n + 1]
        ).sum(axis=0)
        return _Condensed(episode, inverse, cross, total, np.asarray(solve, float), reduced)

    def reduced(self, damping: float = 0.0) -> tuple[Array, Array]:
        """Normal matrix and gradient of the parameters once starts and memories are eliminated."""
        total = self._condensed(self._alike(damping)).reduced
        return total[1:, 1:], total[0, 1:]

    def step(
        self, damping: float, at: Array, low: Array, high: Array, worth: Array, pull: Array
    ) -> tuple[Array, dict[str, tuple[Array, Array]], float]:
        """Steps of the parameters, which are `at` places between bounds and have a prior's normal
        diagonal `worth` and gradient `pull`, and of each episode's starts and memories, and the
        decrease that the linear model expects.
        """
        c, n = self._condensed(self._alike(damping)), self.free
        normal, gradient = c.reduced[1:, 1:] + np.diag(worth), c.reduced[0, 1:] + pull
        moving = ~(((at <= low) & (gradient < 0.0)) | ((at >= high) & (gradient > 0.0))) & (
            np.diag(normal) > NOTHING
        )
        step = np.zeros(n)
        if moving.any():
            part = normal[np.ix_(moving, moving)]
            size = np.sqrt(np.diag(part))
            scaled = part / size[:, None] / size + (damping + 1e-12) * np.eye(len(size))
            step[moving] = rounded(np.linalg.solve(scaled, gradient[moving] / size) / size)
        expected = float(step @ gradient)
        expected += float(
            np.einsum("ei,eij,ej->", c.total[:, n + 1 :, 0], c.solve, c.total[:, n + 1 :, 0])
        )
        expected += float(np.einsum("wi,wij,wj->", c.cross[:, :, 0], c.inverse, c.cross[:, :, 0]))
        return step, c.moves(list(self.parts), step), expected

    def moves_with(self, step: Array) -> dict[str, tuple[Array, Array]]:
        """Steps of each episode's starts and memories beside a step of the parameters."""
        return self._condensed(self._alike(0.0)).moves(list(self.parts), step)

    def reduced_with_scores(self) -> tuple[Array, Array]:
        """Normal matrix of the parameters, and each window's part of their gradient `(windows,
        parameters)`, both without what starts take up.
        """
        c, n = self._condensed(self._alike(0.0)), self.free
        stacked = np.concatenate(list(self.parts.values()))
        taken = np.einsum("wi,wij,wjk->wk", c.cross[:, :, 0], c.inverse, c.cross[:, :, 1 : n + 1])
        return c.reduced[1:, 1:], np.asarray(stacked[:, 0, 1 : n + 1] - taken)

    def _alike(self, damping: float) -> Array:
        return np.full(sum(map(len, self.parts.values())), damping)


@dataclass(frozen=True, slots=True)
class _Condensed:
    """Products of an elimination: `inverse` and `cross` of starts by window, `total` and `solve` of
    memories by episode."""

    episode: NDArray[np.int64]
    inverse: Array
    cross: Array
    total: Array
    solve: Array
    reduced: Array

    def moves(self, episodes: Sequence[str], step: Array) -> dict[str, tuple[Array, Array]]:
        """Steps of each episode's starts and memories beside a step of the parameters."""
        n = len(step)
        missing = self.total[:, n + 1 :, 0] - self.total[:, n + 1 :, 1 : n + 1] @ step
        memory = rounded(np.einsum("eij,ej->ei", self.solve, missing))
        others = np.concatenate([np.repeat(step[None], len(memory), axis=0), memory], axis=1)[
            self.episode
        ]
        missing = self.cross[:, :, 0] - np.einsum("wij,wj->wi", self.cross[:, :, 1:], others)
        windows = rounded(np.einsum("wij,wj->wi", self.inverse, missing))
        return {key: (windows[self.episode == e], memory[e]) for e, key in enumerate(episodes)}


@njit(cache=True, nogil=True, error_model="numpy")
def _eliminate(g, episode, size, damping, inverse, cross, total):  # type: ignore[no-untyped-def]
    """The Schur complement of each window's starting values, summed by episode."""
    own = g.shape[1] - size
    part, solved = np.empty((own, own)), np.empty((own, size))
    for w in range(len(g)):
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
        e = episode[w]
        for i in range(size):
            for k in range(size):
                total[e, i, k] += g[w, i, k]
                for l in range(own):  # noqa: E741
                    total[e, i, k] -= cross[w, l, i] * solved[l, k]


@njit(cache=True, nogil=True)
def _expected(phi, t_s, period_s, i, last):  # type: ignore[no-untyped-def]
    """How much of its noise a sample has from the last one, `last`, -1 where there is none."""
    if phi == 0.0 or last < 0:
        return 0.0
    steps = (t_s[i] - t_s[last]) / period_s
    return phi if abs(steps - 1.0) < EVEN else phi**steps


@njit(cache=True, nogil=True)
def _costs(out, observed, weight, window_of, t_s, period_s, correlation, into):  # type: ignore[no-untyped-def]
    """Sums of squared errors by window and lane."""
    for c in range(observed.shape[1]):
        before, last = np.zeros(out.shape[2]), -1
        for i in range(len(observed)):
            w = window_of[i, c]
            if w < 0 or weight[i, c] == 0.0:
                continue
            if last >= 0 and window_of[last, c] != w:
                last = -1
            part = _expected(correlation[c], t_s, period_s, i, last)
            over = 1.0 / np.sqrt(1.0 - part * part)
            for b in range(out.shape[2]):
                missed = (observed[i, c] - out[i, c, b]) * weight[i, c]
                new = (missed - part * before[b]) * over
                before[b] = missed
                into[w, b] += new * new
            last = i


@njit(cache=True, nogil=True)
def _derivatives(out, weight, inverse, lanes, into):  # type: ignore[no-untyped-def]
    """Derivatives by differences of lanes, weighed as errors are."""
    for i in range(out.shape[0]):
        for c in range(out.shape[1]):
            if weight[i, c] > 0.0:
                for b in range(len(lanes)):
                    moved = out[i, c, lanes[b]] - out[i, c, 0]
                    into[i, c, b] = moved * inverse[lanes[b]] * weight[i, c]


@njit(cache=True, nogil=True)
def _summed(  # type: ignore[no-untyped-def]
    out, observed, weight, window_of, t_s, period_s, correlation, inverse, lanes, against, rows,
    into,
):  # fmt: skip
    """Outer products of (kept derivatives, error, fresh derivatives) summed over each window; those
    of the kept ones are there."""
    kept, size, channels = rows.shape[2], into.shape[1], observed.shape[1]
    row, new = np.zeros(size), np.zeros(size)
    before, last = np.zeros((channels, size)), np.full(channels, -1)
    for i in range(len(observed)):
        for c in range(channels):
            w = window_of[i, c]
            if w < 0 or weight[i, c] == 0.0:
                continue
            base = out[i, c, 0]
            for b in range(kept):
                row[b] = rows[i, c, b]
            row[kept] = (observed[i, c] - base) * weight[i, c]
            for b in range(len(lanes)):
                row[kept + 1 + b] = (
                    (out[i, c, lanes[b]] - out[i, c, against[b]]) * inverse[lanes[b]] * weight[i, c]
                )
            if correlation[c] == 0.0:
                for a in range(kept, size):
                    for b in range(a + 1):
                        into[w, a, b] += row[a] * row[b]
                continue
            if last[c] >= 0 and window_of[last[c], c] != w:
                last[c] = -1
            part = _expected(correlation[c], t_s, period_s, i, last[c])
            over = 1.0 / np.sqrt(1.0 - part * part)
            for b in range(size):
                new[b] = (row[b] - part * before[c, b]) * over
                before[c, b] = row[b]
            last[c] = i
            for a in range(kept, size):
                for b in range(a + 1):
                    into[w, a, b] += new[a] * new[b]
    for w in range(len(into)):
        for a in range(kept, size):
            for b in range(a):
                into[w, b, a] = into[w, a, b]
