"""NARMAX as in SysIdentPy: FROLS on positions and commands, terms by BIC, least squares; it
predicts and cannot name.

Searched: polynomial degree in DEGREES and lags in LAGS; what predicts the validation recordings
best is kept. Recordings are joined, as the package fits one series.
"""

from __future__ import annotations

import warnings

import numpy as np
from sysidentpy.basis_function import Polynomial
from sysidentpy.model_structure_selection import FROLS
from sysidentpy.parameter_estimation import LeastSquares

from bench.peers.case import Case, Recording, answer, error, starts

DEGREES, LAGS = (1, 2, 3), (2, 4)


def solve(case: Case):
    warnings.simplefilter("ignore")
    y = np.concatenate([r.y[:, :1] for r in case.adaptation])
    u = np.concatenate([r.u[:, None] for r in case.adaptation])
    best = None
    for degree in DEGREES:
        for lag in LAGS:
            model = FROLS(
                ylag=lag,
                xlag=lag,
                info_criteria="bic",
                estimator=LeastSquares(),
                basis_function=Polynomial(degree=degree),
            ).fit(X=u, y=y)
            missed = error(
                case, case.validation, lambda r, model=model, lag=lag: _predict(case, model, lag, r)
            )
            if best is None or missed < best[0]:
                best = missed, model, lag
    _, model, lag = best
    return [], lambda r: _predict(case, model, lag, r)


def _predict(case: Case, model: FROLS, lag: int, r: Recording) -> np.ndarray:
    found = r.y.copy()
    for begin in starts(r, case.window):
        end = min(begin + case.window, len(r.t))
        first = max(begin - lag + 1, 0)  # the past that a model with lags needs, where there is one
        path = (
            model.predict(X=r.u[first:end, None], y=r.y[first : first + lag, :1])
            if end - first > lag
            else r.y[first:end, :1]
        )
        found[begin:end, 0] = path[begin - first : end - first, 0]
    return found


if __name__ == "__main__":
    answer(solve)
