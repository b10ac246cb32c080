"""Compiled rollouts of a family's nominal model, without effects: the second kernel, because it is
faster.

It has no ports, hidden states or delays to carry, and computes one lane where only one is asked
for. The kernel with every effect (`kernel.py`) gives the same bits, in 2.7 to 10 times the time
(`python -m bench kernel`); gates, planners and residuals roll out so.

A lane is one parameter vector in one window. Lanes of one window run in blocks of BLOCK with the
time loop outside, so that the compiler keeps a block in vector registers. Blocks are shared out
over threads, for the kernel holds no lock. It is compiled from the family's own text, once for each
family, and kept on disk until that text changes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from itertools import pairwise

import numpy as np
from numba import njit
from numba.cpython.unsafe.tuple import tuple_setitem
from numba.extending import register_jitable
from numpy.typing import NDArray

from trueup.cores import cores
from trueup.model.block import BLOCK
from trueup.model.family import Family, families, source_digest

Array = NDArray[np.float64]
ALONE = 1  # lanes in a block when there are too few vectors to fill one
PARALLEL_LANE_STEPS = (
    200_000  # below this, about 0.3 ms of work, handing it to a thread costs more than it saves
)


@cache
def kernel(family: type[Family], width: int) -> Callable[..., None]:
    """The compiled rollout of a family in blocks of `width` lanes.

    What it closes over must pickle to the same bytes in each process, or the kernel would be
    compiled anew in each: plain values and functions of modules, no nested function.
    """
    acceleration = register_jitable(family.acceleration)
    count = len(family.params)
    zeros = (0.0,) * count
    digest = source_digest(family.acceleration)

    @njit(cache=True, nogil=True, error_model="numpy")
    def run(parameters, initial, applied, h_s, steps, out, first, last):  # type: ignore[no-untyped-def]
        digest  # noqa: B018  (the text compiled from: part of the cache's key)
        q, v, p = np.empty(width), np.empty(width), np.empty((count, width))
        for w in range(applied.shape[0]):
            for start in range(first, last, width):
                for lane in range(width):
                    q[lane], v[lane] = initial[w, 0], initial[w, 1]
                    for j in range(count):
                        p[j, lane] = parameters[j, start + lane]
                for i in range(applied.shape[1]):
                    to_q, to_v = (
                        out[w, i, 0, start : start + width],
                        out[w, i, 1, start : start + width],
                    )
                    for lane in range(width):
                        to_q[lane] = q[lane]
                    for lane in range(width):
                        to_v[lane] = v[lane]
                    u, h = applied[w, i], h_s[w, i]
                    for _ in range(steps[w, i]):
                        for lane in range(width):
                            values = zeros
                            for j in range(count):
                                values = tuple_setitem(values, j, p[j, lane])
                            after = v[lane] + h * acceleration(q[lane], v[lane], u, *values)
                            v[lane] = after
                            q[lane] = q[lane] + h * after

    return run  # type: ignore[no-any-return]


def rollout(
    family: type[Family],
    parameters: Array,
    initial: Array,
    applied: Array,
    h_s: Array,
    steps: NDArray[np.int64],
) -> Array:
    """States `(vectors, windows, samples, 2)`; arguments as in `Dynamics.rollout`, with one command
    `(windows, samples)`."""
    vectors = parameters.shape[0]
    width = BLOCK if vectors >= BLOCK // 4 else ALONE
    lanes = -(-vectors // width) * width
    padded = np.ascontiguousarray(
        np.vstack([parameters, np.repeat(parameters[-1:], lanes - vectors, axis=0)]).T
    )
    out = np.empty((*applied.shape, 2, lanes))
    run = kernel(family, width)
    whole = (
        np.ascontiguousarray(initial),
        np.ascontiguousarray(applied),
        np.ascontiguousarray(h_s),
        np.ascontiguousarray(steps),
    )
    jobs = [
        (padded, *(a[part] for a in whole), out[part], first, last)
        for part, first, last in _shares(applied.shape[0], lanes, width, out.size)
    ]
    if len(jobs) == 1:
        run(*jobs[0])
    else:
        list(_threads().map(lambda job: run(*job), jobs))
    return np.moveaxis(out, 3, 0)[:vectors]


def _shares(windows: int, lanes: int, width: int, size: int) -> Iterable[tuple[slice, int, int]]:
    """Cut the work by blocks of lanes or, where there are fewer of those than threads, by
    windows."""
    threads = 1 if size < 2 * PARALLEL_LANE_STEPS else cores()
    blocks = lanes // width
    if blocks >= threads:
        cuts = np.linspace(0, blocks, threads + 1).astype(int) * width
        return [(slice(None), int(a), int(b)) for a, b in pairwise(cuts)]
    cuts = np.unique(np.linspace(0, windows, threads + 1).astype(int))
    return [(slice(int(a), int(b)), 0, lanes) for a, b in pairwise(cuts)]


@cache
def _threads() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(cores(), thread_name_prefix="rollout")


def compile_all() -> list[str]:
    """Compile every kernel into the cache; the names of the families."""
    for family in families().values():
        parameters = np.ones((1, len(family.params)))
        for vectors in (1, BLOCK):
            windows = np.zeros((1, 2))
            rollout(
                family,
                np.repeat(parameters, vectors, axis=0),
                np.zeros((1, 2)),
                windows,
                windows,
                np.zeros((1, 2), np.int64),
            )
    return list(families())
