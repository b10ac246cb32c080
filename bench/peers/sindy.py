"""Sparse regression as in PySINDy: STLSQ on the derivative of the velocity, documented defaults.

Searched: threshold in THRESHOLDS, and plain or smoothed finite differences; what predicts the
validation recordings best is kept.
"""

from __future__ import annotations

import numpy as np
import pysindy as ps

from bench.peers.case import Case, answer, error, largest, linear, roll, terms

THRESHOLDS = (0.02, 0.05, 0.1, 0.2, 0.5, 1.0)


def solve(case: Case):
    best = None
    for differentiation in (ps.FiniteDifference(), ps.SmoothedFiniteDifference()):
        rows = np.concatenate(
            [terms(case.family, r.y[:, 0], r.y[:, 1], r.u) for r in case.adaptation]
        )
        slope = np.concatenate([differentiation(r.y[:, 1:2], r.t)[:, 0] for r in case.adaptation])
        for threshold in THRESHOLDS:
            weights = ps.STLSQ(threshold=threshold).fit(rows, slope[:, None]).coef_[0]
            model = linear(case, weights)
            missed = error(
                case, case.validation, lambda r, model=model: roll(model, r, case.window, case.dt)
            )
            if best is None or missed < best[0]:
                best = missed, weights, model
    _, weights, model = best
    return largest(case, weights, case.adaptation), lambda r: roll(model, r, case.window, case.dt)


if __name__ == "__main__":
    answer(solve)
