"""What happens at a sample of the compiled rollout: windows start, filters are corrected, and what
is late is sent and shown; as plain functions that the kernel calls."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba.extending import register_jitable

from trueup.model.block import BLOCK, FILTERS
from trueup.model.ports import (
    LAG_S,
    LATE_S,
    PAST,
    Q_AT,
    V_AT,
    Q,
    U,
    V,
    at,
    correct,
    follow,
    jump,
)


def place_at(here: Any, q: Any, v: Any) -> None:
    """A joint set to a position and a velocity, `(lanes,)` each."""
    for lane in range(BLOCK):
        here[at(Q, lane)], here[at(V, lane)] = q[lane], v[lane]


def start_as_filters(
    i: Any, signals: Any, common: Any, memory: Any, on: Any, own: Any, passed: Any, beyond: Any
) -> None:
    """A window's start as the filter has it that each other lane follows."""
    for j in range(len(signals)):
        here = signals[j]
        for lane in range(FILTERS, BLOCK):
            of = lane - FILTERS
            here[at(Q, lane)], here[at(V, lane)] = here[at(Q, of)], here[at(V, of)]
            beyond[j, lane] = beyond[j, of]
            follow(j, signals, common, memory, on, own, of, lane)
    for k in range(min(i, len(passed))):
        for j in range(passed.shape[1]):
            for lane in range(FILTERS, BLOCK):
                passed[k, j, lane] = passed[k, j, lane - FILTERS]


def start_from(
    init: Any, starts: Any, signals: Any, common: Any, memory: Any, on: Any, own: Any, beyond: Any
) -> None:
    """A window's start from positions and velocities `(2 x joints, lanes)`; the hidden states of
    the first `starts` lanes are lane 0's."""
    n = len(signals)
    for j in range(n):
        jump(j, signals, common, memory, on, own, init[n + j])
        for lane in range(1, 1 + starts):
            follow(j, signals, common, memory, on, own, 0, lane)
        place_at(signals[j], init[j], init[n + j])
        for lane in range(BLOCK):
            beyond[j, lane] = 0.0


def show_late(i: Any, j: Any, t_s: Any, here: Any, passed: Any, seen: Any) -> None:
    """What a late sensor shows at a sample: where the joint was, by a cubic through two samples."""
    n = len(seen)
    for lane in range(BLOCK):
        passed[i, j, lane], passed[i, n + j, lane] = here[at(Q, lane)], here[at(V, lane)]
        if here[at(LATE_S, lane)] > 0.0:
            when = t_s[i] - here[at(LATE_S, lane)]
            k = seen[j, lane]
            while k < i - 1 and t_s[k + 1] <= when:
                k += 1
            seen[j, lane] = k
            q0, v0 = passed[k, j, lane], passed[k, n + j, lane]
            if when <= t_s[0] or i == 0:
                here[at(Q_AT, lane)], here[at(V_AT, lane)] = q0 + (when - t_s[0]) * v0, v0
            else:
                span = t_s[k + 1] - t_s[k]
                x = (when - t_s[k]) / span
                q1, v1 = passed[k + 1, j, lane], passed[k + 1, n + j, lane]
                rest = (1.0 - x) * span * v0 - x * span * v1 + (1.0 - 2.0 * x) * (q0 - q1)
                here[at(Q_AT, lane)] = (1.0 - x) * q0 + x * q1 + x * (1.0 - x) * rest
                here[at(V_AT, lane)] = (1.0 - x) * v0 + x * v1


def correct_filters(
    i: Any, gain: Any, observed: Any, push: Any, signals: Any, common: Any, memory: Any,
    on: Any, own: Any,
) -> None:  # fmt: skip
    """The filters corrected by what was observed at a sample."""
    n, now = len(signals), min(i, len(gain) - 1)
    for j in range(n):
        here = signals[j]
        for c in range(2):
            if not np.isfinite(observed[i, c * n + j]):
                continue
            for lane in range(FILTERS):
                shown = here[at(Q_AT, lane)] if c == 0 else here[at(V_AT, lane)]
                missed = observed[i, c * n + j] - shown
                if i == 0:  # the log's first sample is all that is known
                    here[at(Q, lane)] += missed if c == 0 else 0.0
                    here[at(V, lane)] += missed if c == 1 else 0.0
                else:
                    here[at(Q, lane)] += gain[now, j, 0, c, lane] * missed
                    here[at(V, lane)] += gain[now, j, 1, c, lane] * missed
                    push[j, lane] += gain[now, j, 2, c, lane] * missed
                    correct(
                        j, signals, common, memory, on, own,
                        gain[now, j, 1, c, lane], gain[now, j, 3, c, lane], missed, lane,
                    )  # fmt: skip


def send_late(
    j: Any, begins: Any, ends: Any, h_s: Any, t_s: Any, issued: Any, integral: Any,
    here: Any, sent: Any,
) -> None:  # fmt: skip
    """The mean of a delayed command over a step from `begins` to `ends` [s]."""
    last = len(t_s) - 1
    for lane in range(BLOCK):
        lag_s = here[at(LAG_S, lane)]
        if lag_s <= 0.0:
            continue
        k = sent[j, lane]
        when = begins - lag_s
        while k < last and t_s[k + 1] <= when:
            k += 1
        sent[j, lane] = k
        command_then = issued[k, j] if when >= t_s[0] else here[at(PAST, lane)]
        before = integral[k, j] + command_then * (when - t_s[k])
        when = ends - lag_s
        while k < last and t_s[k + 1] < when:
            k += 1
        command_then = issued[k, j] if when >= t_s[0] else here[at(PAST, lane)]
        reached = integral[k, j] + command_then * (when - t_s[k])
        here[at(U, lane)] = (reached - before) / h_s


for _function in (
    place_at, start_as_filters, start_from, show_late, correct_filters, send_late,
):  # fmt: skip
    register_jitable(forceinline=True)(_function)  # compiled into the kernel
