"""Window sums: outer products of errors and derivatives, added up part by part of a rollout.

Derivatives that hardly change from one step to the next, by the nominal form's directions and by
the starts, may be kept from an earlier rollout, and only the others are rolled out again. Source:
C. T. Kelley, Solving Nonlinear Equations with Newton's Method (2003), section 2.4.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from trueup.fit.errors import Errors, KeptDerivatives
from trueup.fit.lanes import LaidOut, Lanes
from trueup.model.stack import Part

Array = NDArray[np.float64]


class WindowSums:
    """Sums of outer products of (error, derivatives) by window, with those derivatives that are
    `old`, or without any; of new ones those by the first `keeps` numbers and by the starts are kept
    for later."""

    def __init__(
        self, errors: Errors, lanes: Lanes, at: LaidOut, keeps: int, old: KeptDerivatives | None
    ) -> None:
        self.errors, self.at, self.old = errors, at, old
        self.numbers, self.first = len(lanes.of), keeps
        samples, windows = errors.observed.shape, len(at.init)
        if old is None:
            self.columns = np.concatenate([lanes.of, 1 + np.arange(lanes.starts)])
            self.against, self.before = lanes.against, np.empty((*samples, 0))
        else:
            self.columns, self.against, self.before = lanes.of, np.zeros_like(lanes.of), old.rows
        behind = range(self.numbers, len(self.columns))
        kept = [*range(keeps), *behind] if keeps and old is None else []
        self.kept = np.array(kept, np.int64)  # which of the columns
        self.rows = np.empty((*samples, len(kept)))
        many = self.before.shape[2]
        size = many + 1 + len(self.columns)
        self.sums = np.zeros((windows, size, size))
        if old is not None:
            self.sums[:, :many, :many] = old.products

    def add(self, part: Part, out: Array) -> None:
        """Add a part's rollout `(samples, 2 x joints, lanes)`."""
        inverse, columns = self.at.inverse, self.columns
        self.errors.add_sums(part, out, inverse, columns, self.against, self.before, self.sums)
        if len(self.kept):
            self.errors.derivatives(part, out, inverse, columns[self.kept], self.rows)

    def done(self, usual: Array) -> tuple[Array, KeptDerivatives | None]:
        """The sums of all parts, of derivatives by steps of starts that are as long as the `usual`
        ones `(2 x joints,)`, and the derivatives that may be kept."""
        if self.old is not None:
            return self._in_order(self.old), self.old
        if self.at.steps is not None:
            ones = np.ones((len(self.sums), 1 + self.numbers))
            per = np.concatenate([ones, usual / self.at.steps], axis=1)
            self.sums *= per[:, :, None] * per[:, None, :]
        if not len(self.kept):
            return self.sums, None
        of = 1 + self.kept
        products = np.ascontiguousarray(self.sums[:, of[:, None], of])
        return self.sums, KeptDerivatives(self.rows, products, self.first)

    def _in_order(self, old: KeptDerivatives) -> Array:
        """Sums of (old derivatives, error, new ones) in the order of a window's matrix."""
        many, fresh = self.before.shape[2], len(self.columns)
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
        into = np.empty_like(self.sums)
        into[:, at[:, None], at] = self.sums
        return into
