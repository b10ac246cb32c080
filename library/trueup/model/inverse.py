"""Inverses of small symmetric positive definite matrices, as plain functions that compiled code
calls: Gauss-Jordan elimination without pivoting."""

from __future__ import annotations

from typing import Any

from numba.extending import register_jitable

from trueup.model.block import BLOCK


def invert_lanes(matrix: Any, room: Any) -> None:
    """Symmetric positive definite matrices `(n, n x lanes)` turned into their inverses. `room` is
    for two rows of it: whole rows are what the compiler keeps in registers.
    """
    n, factor, solved = len(matrix), room[0], room[1]
    for i in range(n):
        row, pivot = matrix[i], matrix[i, i * BLOCK : (i + 1) * BLOCK]
        spread(pivot, factor)
        for lane in range(BLOCK):
            pivot[lane] = 1.0
        for at in range(n * BLOCK):
            solved[at] = row[at] / factor[at]
        for at in range(n * BLOCK):
            row[at] = solved[at]
        for j in range(n):
            if j != i:
                other, eliminated = matrix[j], matrix[j, i * BLOCK : (i + 1) * BLOCK]
                spread(eliminated, factor)
                for lane in range(BLOCK):
                    eliminated[lane] = 0.0
                for at in range(n * BLOCK):
                    other[at] -= factor[at] * solved[at]


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
