"""The compiled rollout of one block over one episode, for every family and every tree with every
effect.

A *block* is one hypothesis: BLOCK lanes that share which effects act, and differ in parameters and
initial states. Loops over lanes are innermost, so that the compiler keeps them in vector registers.
What effects do is called port by port (`ports.py`).

- Each episode runs from its first sample to its last; hidden states (lag, play, heat, hysteresis)
  run through.
- At the start of a window position and velocity are set, which is no motion; the rest keeps its
  past.
- Lanes that differ in their starts have lane 0's past at each of them, so that they show what a
  start does in its own window.
- Where the first FILTERS lanes are filters, each is corrected by each observation with a gain of
  its own: its position, its velocity, a force that disturbs it and what hides its velocity. Each of
  the others starts each window from the whole state of one of them.

Two schemes of integration: the declared one (semi-implicit Euler, alpha 0), and its symmetric form
(alpha 1/2), in which position drifts, velocity is kicked and position drifts, of second order.
Source: E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration (2006), section I.3. Dry
friction is a projection of the kicked velocity: J. J. Moreau (1988).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
from numba import njit
from numba.extending import register_jitable

from trueup.model import ports
from trueup.model.block import BLOCK, FILTERS
from trueup.model.dynamics import TREE_FORM
from trueup.model.family import source_digest
from trueup.model.inverse import invert_lanes
from trueup.model.kernel_step import (
    accelerate,
    move_joint,
    move_tree,
    part_forces,
    pass_through_links,
    to_error,
)
from trueup.model.ports import (
    IMPLICIT,
    LAG_S,
    LATE_S,
    LEVEL,
    MOBILITY,
    PAST,
    PERIOD,
    Q_AT,
    SIGNALS_AT_JOINT,
    SIGNALS_OF_ALL,
    SINCE,
    U_SCALE,
    V_AT,
    A,
    H,
    Q,
    T,
    U,
    V,
    answer,
    answers_asked,
    begin,
    command,
    correct,
    delays,
    drive,
    follow,
    force,
    friction,
    goal,
    jump,
    nominal,
    observe,
    parts_asked,
    timing,
)
from trueup.model.rigid_body import LINK_ROWS, crba
from trueup.model.tree import GAIN, JOINT, LINK, OFFSET, SERVO

MEMORY = max(1, len(ports.memories()))
AT_JOINT, OF_ALL = len(SIGNALS_AT_JOINT), len(SIGNALS_OF_ALL)


@cache
def kernel() -> Callable[..., None]:
    """The compiled rollout.

    p `(rows, BLOCK)`; on `(effects, joints)`; first the row of the first joint's effects; family
    its number, -1 for a tree; tree `(joints, TREE)`; sizes `(joints,)` the inertia against which an
    effect's forces are measured; u_scale `(joints,)`; t_s, h_s, steps, resets (the window that
    starts at a sample, or -1) `(samples,)`; issued, the mean command until the next sample, its
    rise meanwhile and its integral up to each sample `(samples, joints)`; init `(windows, 2 x
    joints, BLOCK)`; gain `(beginning, joints, 4, 2, FILTERS)`; observed `(samples, 2 x joints)`;
    writes out `(samples, 2 x joints, BLOCK)`.
    """
    return _compiled(
        ",".join(
            (
                ports.digest(),
                source_digest(crba),
                source_digest(accelerate),
                source_digest(invert_lanes),
            )
        )
    )


def _compiled(made_of: str) -> Callable[..., None]:
    """The kernel as the compiler keeps it: under this file's stamp, and under the digest of what it
    calls."""

    @njit(cache=True, nogil=True, error_model="numpy")
    def run(  # type: ignore[no-untyped-def]
        p, on, first, family, tree, sizes, alpha, u_scale, period, t_s, h_s, steps, issued, rise,
        integral, resets, init, starts, is_filter, gain,
        observed, out,
    ):  # fmt: skip
        made_of  # noqa: B018  (part of the cache's key)
        n, last = len(u_scale), len(t_s) - 1
        signals, common = np.zeros((AT_JOINT, n, BLOCK)), np.zeros((OF_ALL, BLOCK))
        memory = np.zeros((MEMORY, n, BLOCK))
        q, v, u, a = signals[Q], signals[V], signals[U], signals[A]
        level, q_at, v_at = signals[LEVEL], signals[Q_AT], signals[V_AT]
        own = p[first:]  # the effects' parameters
        links, inverse_mass = np.zeros((n, LINK_ROWS * BLOCK)), np.zeros((n, n * BLOCK))
        room, holding = np.zeros((2, n * BLOCK)), np.zeros(BLOCK)
        forces, free, held = np.zeros((n, BLOCK)), np.zeros((n, BLOCK)), np.zeros((n, BLOCK))
        nothing, beyond = np.zeros((n, BLOCK)), np.zeros((n, BLOCK))
        push = np.zeros((n, FILTERS))
        for lane in range(BLOCK):
            common[PERIOD, lane], common[IMPLICIT, lane] = period, 1.0 - 2.0 * alpha
        for j in range(n):
            for lane in range(BLOCK):
                u[j, lane], signals[MOBILITY, j, lane] = issued[0, j], 1.0
                signals[U_SCALE, j, lane] = u_scale[j]
        delayed, late = start(signals, common, memory, on, own, family)
        # samples: whose command is on its way to each joint, and that each sensor shows
        sent, seen = np.zeros((n, BLOCK), np.int64), np.zeros((n, BLOCK), np.int64)
        passed = np.zeros((last + 1 if late else 0, 2 * n, BLOCK))
        parts, answers = parts_asked(on), answers_asked(on)
        for i in range(last + 1):
            if is_filter and i == 0:
                for j in range(n):
                    for lane in range(BLOCK):
                        q[j, lane], v[j, lane] = init[0, j, lane], init[0, n + j, lane]
            elif is_filter and resets[i] >= 0:
                start_as_filters(i, signals, common, memory, on, own, passed, beyond)
            elif resets[i] >= 0:
                start_from(init[resets[i]], starts, signals, common, memory, on, own, beyond)
            for lane in range(BLOCK):
                common[T, lane], common[SINCE, lane] = t_s[i], t_s[i] - t_s[i - 1] if i > 0 else 0.0
            for j in range(n):
                for lane in range(BLOCK):
                    q_at[j, lane], v_at[j, lane] = q[j, lane], v[j, lane]
                if late:
                    show_late(i, j, t_s, signals, passed, seen)
                observe(j, signals, common, memory, on, own)
            if is_filter:
                correct_filters(i, gain, observed, push, signals, common, memory, on, own)
                if resets[i] >= 0:
                    for lane in range(FILTERS, BLOCK):
                        for j in range(n):
                            q[j, lane], v[j, lane] = q[j, lane - FILTERS], v[j, lane - FILTERS]
                            follow(j, signals, common, memory, on, own, lane - FILTERS, lane)
            for j in range(n):
                for lane in range(BLOCK):
                    out[i, j, lane] = q_at[j, lane]
                    out[i, n + j, lane] = v_at[j, lane]
            for step in range(steps[i]):
                for lane in range(BLOCK):
                    common[H, lane] = h_s[i]
                for j in range(n):
                    for lane in range(BLOCK):
                        u[j, lane] = issued[i, j] + rise[i, j] * ((step + 0.5) / steps[i] - 0.5)
                    if delayed:
                        begins, ends = t_s[i] + step * h_s[i], t_s[i] + (step + 1) * h_s[i]
                        send_late(j, begins, ends, h_s[i], t_s, issued, integral, signals, sent)
                    if j == 0:
                        timing(j, signals, common, memory, on, own)
                    for lane in range(BLOCK):
                        q_at[j, lane] = q[j, lane] + alpha * common[H, lane] * v[j, lane]
                        v_at[j, lane] = v[j, lane]
                    at = LINK * n + JOINT * j
                    if family == TREE_FORM and p[at + SERVO, 0] != 0.0:
                        # effects change a servo's goal, or its drive, which acts on the error
                        goal(j, signals, common, memory, on, own)
                        to_error(
                            u[j], q_at[j], p[at + SERVO], p[at + GAIN], tree[j, OFFSET], holding,
                        )  # fmt: skip
                        drive(j, signals, common, memory, on, own)
                        for lane in range(BLOCK):
                            u[j, lane] += holding[lane]
                    else:
                        command(j, signals, common, memory, on, own)
                nominal(signals, common, p, family, alpha, parts)
                if family == TREE_FORM:
                    accelerate(
                        p, tree, sizes, alpha, common, signals, links, inverse_mass, room,
                        forces, beyond,
                    )  # fmt: skip
                    if parts:
                        part_forces(
                            p, tree, sizes, signals, links, inverse_mass, forces, free, nothing,
                        )  # fmt: skip
                for j in range(n):
                    force(j, signals, common, memory, on, own)
                if family == TREE_FORM and answers:
                    pass_through_links(signals, sizes, inverse_mass, forces)
                for j in range(n):
                    answer(j, signals, common, memory, on, own)
                    if family == TREE_FORM:
                        for lane in range(BLOCK):
                            beyond[j, lane] = sizes[j] * a[j, lane] - forces[j, lane]
                    if is_filter:
                        # of filters alone: what disturbs the machine for a while is not foretold
                        for lane in range(FILTERS):
                            a[j, lane] += push[j, lane]
                    for lane in range(BLOCK):
                        level[j, lane] = 0.0
                    friction(j, signals, common, memory, on, own)
                if family == TREE_FORM:
                    move_tree(p, sizes, alpha, signals, common, inverse_mass, held, free, forces)
                else:
                    move_joint(alpha, signals, common)

    return run  # type: ignore[no-any-return]


def start(signals: Any, common: Any, memory: Any, on: Any, own: Any, family: Any) -> Any:
    """Hidden states and delays before the first sample; whether commands are late, and whether a
    sensor is."""
    delayed, late = False, False
    for j in range(signals.shape[1]):
        begin(j, signals, common, memory, on, own)
    for j in range(signals.shape[1]):
        any_on = delays(j, signals, common, memory, on, own)
        delayed = delayed or any_on
    for j in range(signals.shape[1]):
        for lane in range(BLOCK):
            if family != TREE_FORM:  # on the log of one joint alone a late sensor is a late drive
                signals[LAG_S, j, lane] = signals[LAG_S, j, lane] + signals[LATE_S, j, lane]
                signals[LATE_S, j, lane] = 0.0
            late = late or signals[LATE_S, j, lane] > 0.0
    return delayed, late


def start_as_filters(
    i: Any, signals: Any, common: Any, memory: Any, on: Any, own: Any, passed: Any, beyond: Any
) -> None:
    """A window's start as the filter has it that each other lane follows."""
    for j in range(signals.shape[1]):
        for lane in range(FILTERS, BLOCK):
            of = lane - FILTERS
            signals[Q, j, lane], signals[V, j, lane] = signals[Q, j, of], signals[V, j, of]
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
    n = signals.shape[1]
    for j in range(n):
        jump(j, signals, common, memory, on, own, init[n + j])
        for lane in range(1, 1 + starts):
            follow(j, signals, common, memory, on, own, 0, lane)
        for lane in range(BLOCK):
            signals[Q, j, lane], signals[V, j, lane] = init[j, lane], init[n + j, lane]
            beyond[j, lane] = 0.0


def show_late(i: Any, j: Any, t_s: Any, signals: Any, passed: Any, seen: Any) -> None:
    """What a late sensor shows at a sample: where the joint was, by a cubic through two samples."""
    n = signals.shape[1]
    for lane in range(BLOCK):
        passed[i, j, lane], passed[i, n + j, lane] = signals[Q, j, lane], signals[V, j, lane]
        if signals[LATE_S, j, lane] > 0.0:
            when = t_s[i] - signals[LATE_S, j, lane]
            k = seen[j, lane]
            while k < i - 1 and t_s[k + 1] <= when:
                k += 1
            seen[j, lane] = k
            q0, v0 = passed[k, j, lane], passed[k, n + j, lane]
            if when <= t_s[0] or i == 0:
                signals[Q_AT, j, lane], signals[V_AT, j, lane] = q0 + (when - t_s[0]) * v0, v0
            else:
                span = t_s[k + 1] - t_s[k]
                x = (when - t_s[k]) / span
                q1, v1 = passed[k + 1, j, lane], passed[k + 1, n + j, lane]
                rest = (1.0 - x) * span * v0 - x * span * v1 + (1.0 - 2.0 * x) * (q0 - q1)
                signals[Q_AT, j, lane] = (1.0 - x) * q0 + x * q1 + x * (1.0 - x) * rest
                signals[V_AT, j, lane] = (1.0 - x) * v0 + x * v1


def correct_filters(
    i: Any, gain: Any, observed: Any, push: Any, signals: Any, common: Any, memory: Any,
    on: Any, own: Any,
) -> None:  # fmt: skip
    """The filters corrected by what was observed at a sample."""
    n, now = signals.shape[1], min(i, len(gain) - 1)
    for j in range(n):
        for c in range(2):
            if not np.isfinite(observed[i, c * n + j]):
                continue
            for lane in range(FILTERS):
                shown = signals[Q_AT, j, lane] if c == 0 else signals[V_AT, j, lane]
                missed = observed[i, c * n + j] - shown
                if i == 0:  # the log's first sample is all that is known
                    signals[Q, j, lane] += missed if c == 0 else 0.0
                    signals[V, j, lane] += missed if c == 1 else 0.0
                else:
                    signals[Q, j, lane] += gain[now, j, 0, c, lane] * missed
                    signals[V, j, lane] += gain[now, j, 1, c, lane] * missed
                    push[j, lane] += gain[now, j, 2, c, lane] * missed
                    correct(
                        j, signals, common, memory, on, own,
                        gain[now, j, 1, c, lane], gain[now, j, 3, c, lane], missed, lane,
                    )  # fmt: skip


def send_late(
    j: Any, begins: Any, ends: Any, h_s: Any, t_s: Any, issued: Any, integral: Any,
    signals: Any, sent: Any,
) -> None:  # fmt: skip
    """The mean of a delayed command over a step from `begins` to `ends` [s]."""
    last = len(t_s) - 1
    for lane in range(BLOCK):
        lag_s = signals[LAG_S, j, lane]
        if lag_s <= 0.0:
            continue
        k = sent[j, lane]
        when = begins - lag_s
        while k < last and t_s[k + 1] <= when:
            k += 1
        sent[j, lane] = k
        command_then = issued[k, j] if when >= t_s[0] else signals[PAST, j, lane]
        before = integral[k, j] + command_then * (when - t_s[k])
        when = ends - lag_s
        while k < last and t_s[k + 1] < when:
            k += 1
        command_then = issued[k, j] if when >= t_s[0] else signals[PAST, j, lane]
        reached = integral[k, j] + command_then * (when - t_s[k])
        signals[U, j, lane] = (reached - before) / h_s


for _function in (
    start, start_as_filters, start_from, show_late, correct_filters, send_late,
):  # fmt: skip
    register_jitable(forceinline=True)(_function)  # compiled into the kernel
