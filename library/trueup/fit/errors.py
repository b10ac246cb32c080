"""Errors of a rollout, and their sums by window: of squares, and of outer products with
derivatives.

A row of a sum is (error, directions and numbers, memories, start).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from trueup.model.stack import Part

Array = NDArray[np.float64]
Lanes = NDArray[np.int64]
EVEN = 1e-3  # of a period: stamps that are so regular
AT_ONCE = 64  # samples whose products are added up together, a multiple of four


@dataclass(frozen=True, slots=True)
class KeptDerivatives:
    """Weighted derivatives of a rollout by `first` directions and by the starts, `(samples, 2 x
    joints, kept)`, and the sums of their outer products by window `(windows, kept, kept)`."""

    rows: Array
    products: Array
    first: int


@dataclass(frozen=True, slots=True)
class Errors:
    """What a rollout of a stack is compared with, and what an error counts.

    `observed` and `counts` `(samples, 2 x joints)`, how much each counts, 0 where nothing was seen;
    `sigma` `(2 x joints,)` the standard deviation of the noise; `window_of` the window that a
    sample is an error of; `t_s` `(samples,)` [s]. `correlation` `(2 x joints,)` is that of the
    noise with itself one period before, of a window `periods_s` `(windows,)` [s]: errors are taken
    less what the noise of the last one leads to expect. The first error of a window counts as it
    is. `episode_of` `(windows,)` is a window's episode. Source: D. Cochrane, G. H. Orcutt, Journal
    of the American Statistical Association 44 (1949); for the first error S. J. Prais, C. B.
    Winsten, Cowles Commission Discussion Paper 383 (1954).
    """

    observed: Array
    counts: Array
    sigma: Array
    window_of: NDArray[np.int64]
    t_s: Array
    periods_s: Array
    correlation: Array
    episode_of: NDArray[np.int64]

    def _of(self, part: Part) -> tuple[Any, ...]:
        samples = part.samples
        return (
            self.observed[samples],
            self.counts[samples],
            self.sigma,
            self.window_of[samples],
            self.t_s[samples],
            self.periods_s,
            self.correlation,
        )

    def add_sums(
        self,
        part: Part,
        out: Array,
        inverse: Array,
        lanes: Lanes,
        against: Lanes,
        rows: Array,
        into: Array,
    ) -> None:
        """Add sums of outer products of (kept derivatives, error, derivatives) by window `into`
        `(windows, size, size)`, of a part's rollout `(samples, 2 x joints, lanes)`; those of the
        kept derivatives `rows` `(samples, 2 x joints, kept)` are there.

        Its first lane is unperturbed; `lanes` are those of the derivatives, `against` which they
        are differences, `inverse` `(episodes, lanes)` is that of each lane's step.
        """
        windows, kept = part.windows, rows[part.samples]
        _summed(out, *self._of(part), self.episode_of, inverse, lanes, against, kept, into)
        _mirrored(into[windows], rows.shape[2])

    def derivatives(
        self, part: Part, out: Array, inverse: Array, lanes: Lanes, into: Array
    ) -> None:
        """Write the derivatives by `lanes` of a part's rollout, weighed as errors are, `into`
        `(samples, 2 x joints, lanes)`."""
        _, counts, sigma, window_of, *_ = self._of(part)
        _derivatives(
            out, counts, sigma, window_of, self.episode_of, inverse, lanes, into[part.samples]
        )

    def add_costs(self, part: Part, out: Array, into: Array) -> None:
        """Add the squared errors of each window and lane of a part's rollout `into` `(windows,
        lanes)`."""
        _costs(out, *self._of(part), into)


@njit(cache=True, nogil=True, error_model="numpy")
def _expected(phi, t_s, period_s, i, last):  # type: ignore[no-untyped-def]
    """How much of its noise a sample has from the last one, `last`, -1 where there is none."""
    if phi == 0.0 or last < 0:
        return 0.0
    steps = (t_s[i] - t_s[last]) / period_s
    return phi if abs(steps - 1.0) < EVEN else phi**steps


@njit(cache=True, nogil=True, error_model="numpy")
def _costs(  # type: ignore[no-untyped-def]
    out, observed, counts, sigma, window_of, t_s, periods_s, correlation, into
):
    """Sums of squared errors by window and lane."""
    for c in range(observed.shape[1]):
        before, last = np.zeros(out.shape[2]), -1
        for i in range(len(observed)):
            w, by = window_of[i, c], counts[i, c] / sigma[c]
            if w < 0 or by == 0.0:
                continue
            if last >= 0 and window_of[last, c] != w:
                last = -1
                before[:] = 0.0  # what ran away in one window is none of the next
            part = _expected(correlation[c], t_s, periods_s[w], i, last)
            over = 1.0 / np.sqrt(1.0 - part * part)
            for b in range(out.shape[2]):
                missed = (observed[i, c] - out[i, c, b]) * by
                new = (missed - part * before[b]) * over
                before[b] = missed
                into[w, b] += new * new
            last = i


@njit(cache=True, nogil=True, error_model="numpy")
def _derivatives(  # type: ignore[no-untyped-def]
    out, counts, sigma, window_of, episode_of, inverse, lanes, into
):
    """Derivatives by differences of lanes, weighed as errors are; 0 where nothing counts."""
    for i in range(out.shape[0]):
        for c in range(out.shape[1]):
            w, by = window_of[i, c], counts[i, c] / sigma[c]
            for b in range(len(lanes)):
                if w >= 0 and by > 0.0:
                    moved = out[i, c, lanes[b]] - out[i, c, 0]
                    into[i, c, b] = moved * inverse[episode_of[w], lanes[b]] * by
                else:
                    into[i, c, b] = 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def _summed(  # type: ignore[no-untyped-def]
    out, observed, counts, sigma, window_of, t_s, periods_s, correlation, episode_of, inverse,
    lanes, against, rows, into,
):  # fmt: skip
    """Outer products of (kept derivatives, error, fresh derivatives) summed over each window, below
    the diagonal; those of the kept ones are there."""
    kept, size = rows.shape[2], into.shape[1]
    some, before = np.zeros((size, AT_ONCE)), np.zeros(size)
    for c in range(observed.shape[1]):
        window, last, count = -1, -1, 0
        for i in range(len(observed)):
            w, by = window_of[i, c], counts[i, c] / sigma[c]
            if w < 0 or by == 0.0:
                continue
            if count and (w != window or count == AT_ONCE):
                _add(some, count, kept, into, window)
                count = 0
            if w != window:
                window, last = w, -1
                before[:] = 0.0  # what ran away in one window is none of the next
            e = episode_of[w]
            for b in range(kept):
                some[b, count] = rows[i, c, b]
            some[kept, count] = (observed[i, c] - out[i, c, 0]) * by
            for b in range(len(lanes)):
                moved = out[i, c, lanes[b]] - out[i, c, against[b]]
                some[kept + 1 + b, count] = moved * inverse[e, lanes[b]] * by
            if correlation[c] != 0.0:
                part = _expected(correlation[c], t_s, periods_s[w], i, last)
                over = 1.0 / np.sqrt(1.0 - part * part)
                for b in range(size):
                    one = some[b, count]
                    some[b, count] = (one - part * before[b]) * over
                    before[b] = one
                last = i
            count += 1
        if count:
            _add(some, count, kept, into, window)


@njit(cache=True, nogil=True)
def _add(some, count, kept, into, window):  # type: ignore[no-untyped-def]
    """Add the products of rows (kept derivatives, error, fresh derivatives), `some` `(size,
    AT_ONCE)` of which the first `count` columns are filled, to a window's, but those of kept
    ones."""
    _add_squares(some, count, kept, into, window)
    _add_products(some, count, kept, into, window)


@njit(cache=True, nogil=True)
def _add_squares(some, count, kept, into, window):  # type: ignore[no-untyped-def]
    """Add the squares of the errors, `some[kept]`, to a window's, in one order on every processor,
    for costs are compared; in fours, so that only one addition in four waits for the one before."""
    end, added = -(-count // 4) * 4, 0.0
    some[kept, count:end] = 0.0
    for s in range(0, end, 4):
        first = some[kept, s] ** 2 + some[kept, s + 1] ** 2
        added += first + (some[kept, s + 2] ** 2 + some[kept, s + 3] ** 2)
    into[window, kept, kept] += added


# the compiler may reorder these sums: they go to linear algebra alone, whose own order differs by
# processor
@njit(cache=True, nogil=True, fastmath={"reassoc", "contract"})
def _add_products(some, count, kept, into, window):  # type: ignore[no-untyped-def]
    """Add all other products to a window's."""
    for a in range(kept, into.shape[1]):
        for b in range(a + (a > kept)):
            added = 0.0
            for s in range(count):
                added += some[a, s] * some[b, s]
            into[window, a, b] += added


@njit(cache=True, nogil=True)
def _mirrored(into, kept):  # type: ignore[no-untyped-def]
    """Above the diagonal what is below it."""
    for w in range(len(into)):
        for a in range(kept, into.shape[1]):
            for b in range(a):
                into[w, b, a] = into[w, a, b]
