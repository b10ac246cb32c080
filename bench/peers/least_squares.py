"""Plain least squares with forward selection by BIC over the same terms, on central differences of
the velocity."""

from __future__ import annotations

import numpy as np

from bench.peers.case import TERMS, Case, answer, largest, linear, roll, terms


def solve(case: Case):
    rows = np.concatenate(
        [terms(case.family, r.y[:, 0], r.y[:, 1], r.u)[1:-1] for r in case.adaptation]
    )
    slope = np.concatenate(
        [(r.y[2:, 1] - r.y[:-2, 1]) / (r.t[2:] - r.t[:-2]) for r in case.adaptation]
    )
    own = rows.shape[1] - len(TERMS)
    chosen = list(range(own))

    def bic(columns):
        fitted = np.linalg.lstsq(rows[:, columns], slope, rcond=None)[0]
        return len(slope) * np.log(np.mean((slope - rows[:, columns] @ fitted) ** 2)) + len(
            columns
        ) * np.log(len(slope)), fitted

    score, fitted = bic(chosen)
    while rest := [c for c in range(rows.shape[1]) if c not in chosen]:
        (better, more), added = min(
            ((bic([*chosen, c]), c) for c in rest), key=lambda found: found[0][0]
        )
        if better >= score:
            break
        score, fitted, chosen = better, more, [*chosen, added]
    weights = np.zeros(rows.shape[1])
    weights[chosen] = fitted
    model = linear(case, weights)
    return largest(case, weights, case.adaptation), lambda r: roll(model, r, case.window, case.dt)


if __name__ == "__main__":
    answer(solve)
