"""Linear least squares with what is known about its answer."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

Array = NDArray[np.float64]
UPPER = 0.975  # probability below the upper end of a 95 % interval


@dataclass(frozen=True, slots=True)
class LinearFit:
    """`values` `(columns,)`; their 95 % half-widths `(columns,)`, by Student's distribution; rank
    and condition number of the scaled design."""

    values: Array
    half_widths: Array
    rank: int
    condition: float
    residual_rms: float


def solve(design: Array, target: Array, correlated_rows: int = 1) -> LinearFit:
    """Least squares of `target` `(rows,)` on `design` `(rows, columns)`.

    The condition number is that of the design with columns of unit length, so that units do not
    enter. The intervals take `correlated_rows` neighbouring residuals as one: overlapping spans
    share their noise.
    """
    lengths = np.linalg.norm(design, axis=0)
    scaled = design / np.where(lengths > 0.0, lengths, 1.0)
    values, _, rank, singular = np.linalg.lstsq(scaled, target, rcond=None)
    residual = target - scaled @ values
    freedom = max(len(target) / correlated_rows - design.shape[1], 1.0)
    variance = float(residual @ residual) / correlated_rows / freedom
    covariance = variance * correlated_rows * np.linalg.pinv(scaled.T @ scaled)
    divisor = np.where(lengths > 0.0, lengths, np.inf)
    condition = float(singular[0] / singular[-1]) if singular[-1] > 0.0 else float("inf")
    return LinearFit(
        values / divisor,
        stdtrit(freedom, UPPER) * np.sqrt(np.diag(covariance)) / divisor,
        int(rank),
        condition,
        float(np.sqrt(np.mean(residual**2))),
    )


def ridge(design: Array, targets: Array, penalty: float) -> Array:
    """Weights `(columns, targets)` by the normal equations with `penalty` on every weight."""
    return np.asarray(
        np.linalg.solve(design.T @ design + penalty * np.eye(design.shape[1]), design.T @ targets)
    )
