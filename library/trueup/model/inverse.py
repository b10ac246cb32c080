"""Inverses of small symmetric positive definite matrices, as plain functions that compiled code
calls: Gauss-Jordan elimination without pivoting."""

from __future__ import annotations

from typing import Any

from numba.extending import register_jitable

from trueup.model.block import BLOCK


def invert_lanes(matrix: Any, into: Any, wide: Any) -> None:
    """Inverses of symmetric positive definite matrices, both `(n, n x lanes)`; the matrices are
    used up. `wide` is room for a row."""
    n = len(matrix)
    for i in range(n):
        row = into[i]
        for at in range(n * BLOCK):
            row[at] = 0.0
        identity = row[i * BLOCK : (i + 1) * BLOCK]
        for lane in range(BLOCK):
            identity[lane] = 1.0
    for i in range(n):
        spread(matrix[i, i * BLOCK : (i + 1) * BLOCK], wide)
        pivot, solved = matrix[i], into[i]
        for at in range(n * BLOCK):
            pivot[at] /= wide[at]
        for at in range(n * BLOCK):
            solved[at] /= wide[at]
        for j in range(n):
            if j != i:
                spread(matrix[j, i * BLOCK : (i + 1) * BLOCK], wide)
                below, result = matrix[j], into[j]
                for at in range(n * BLOCK):
                    below[at] -= wide[at] * pivot[at]
                for at in range(n * BLOCK):
                    result[at] -= wide[at] * solved[at]


def spread(lanes: Any, wide: Any) -> None:
    """A block of lanes repeated along a row."""
    for k in range(len(wide) // BLOCK):
        part = wide[k * BLOCK : (k + 1) * BLOCK]
        for lane in range(BLOCK):
            part[lane] = lanes[lane]


def invert(matrix: Any, into: Any) -> None:
    """Inverse of one symmetric positive definite matrix, both `(n, n)`; the matrix is used up."""
    n = len(matrix)
    for i in range(n):
        for k in range(n):
            into[i, k] = 1.0 if i == k else 0.0
    for i in range(n):
        over = 1.0 / matrix[i, i]
        for k in range(n):
            matrix[i, k] *= over
            into[i, k] *= over
        for j in range(n):
            if j != i:
                factor = matrix[j, i]
                for k in range(n):
                    matrix[j, k] -= factor * matrix[i, k]
                    into[j, k] -= factor * into[i, k]


for _function in (invert_lanes, spread, invert):
    register_jitable(_function)  # compiled into what calls them
