"""The compiled rollout of one block over one episode, for every family and every tree with every
effect.

A *block* is one hypothesis: BLOCK lanes that share which effects act, and differ in parameters and
initial states. Loops over lanes are innermost, so that the compiler keeps them in vector registers.
What effects do is called port by port (`ports.py`).

    each episode runs from its first sample to its last; hidden states (lag, play, heat, hysteresis)
    run through at the start of a window, position and velocity are set, which is no motion; the
    rest keeps its past lanes that differ in their starts have lane 0's past at each of them, so
    that they show what a start does in its own window where lanes follow lane 0, lane 0 is
    corrected by each observation, in position, velocity, a force that disturbs it and what hides
    its velocity, and the others start each window from its whole state

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
from trueup.model.block import BLOCK
from trueup.model.family import source_digest
from trueup.model.ports import (
    DRIVE,
    IMPLICIT,
    LAG_S,
    LATE_S,
    LEVEL,
    MOBILITY,
    PASSIVE,
    PAST,
    PERIOD,
    Q_AT,
    SIGNALS_AT_JOINT,
    SIGNALS_OF_ALL,
    SINCE,
    SPRING,
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
from trueup.model.rigid_body import ROOM, bias, invert_lanes, net, pose, rub
from trueup.model.tree import DAMPING, FRICTION, GAIN, JOINT, LIMIT, LINK, OFFSET, SERVO

MEMORY = max(1, len(ports.memories()))
AT_JOINT, OF_ALL = len(SIGNALS_AT_JOINT), len(SIGNALS_OF_ALL)
TREE_FORM = -1  # the number of a tree, where a family has its own


@cache
def kernel() -> Callable[..., None]:
    """The compiled rollout.

    p `(rows, BLOCK)`; on `(effects, joints)`; first the row of the first joint's effects; family
    its number, -1 for a tree; tree `(joints, TREE)`; sizes `(joints,)` the inertia against which an
    effect's forces are measured; u_scale `(joints,)`; t_s, h_s, steps, resets (the window that
    starts at a sample, or -1) `(samples,)`; issued and its integral up to each sample `(samples,
    joints)`; init `(windows, 2 x joints, BLOCK)`; gain `(beginning, joints, 4, 2)`; observed
    `(samples, 2 x joints)`; writes out `(samples, 2 x joints, BLOCK)`.
    """
    return _compiled(",".join((ports.digest(), source_digest(pose))))


def _compiled(made_of: str) -> Callable[..., None]:
    """The kernel as the compiler keeps it: under this file's stamp, and under the digest of what it
    calls."""

    @njit(cache=True, nogil=True, error_model="numpy")
    def run(  # type: ignore[no-untyped-def]
        p, on, first, family, tree, sizes, alpha, u_scale, period, t_s, h_s, steps, issued,
        integral, resets, init, starts, is_filter, gain,
        observed, out,
    ):  # fmt: skip
        made_of  # noqa: B018  (part of the cache's key)
        n, last = len(u_scale), len(t_s) - 1
        signals, common, memory = (
            np.zeros((AT_JOINT, n, BLOCK)),
            np.zeros((OF_ALL, BLOCK)),
            np.zeros((MEMORY, n, BLOCK)),
        )
        q, v, u, a, level, q_at, v_at = (
            signals[Q],
            signals[V],
            signals[U],
            signals[A],
            signals[LEVEL],
            signals[Q_AT],
            signals[V_AT],
        )
        own = p[first:]  # the effects' parameters
        room, mass, moves = (
            np.zeros((n, ROOM * BLOCK)),
            np.zeros((n, n * BLOCK)),
            np.zeros((n, n * BLOCK)),
        )
        wide, forces, free, held = (
            np.zeros(n * BLOCK),
            np.zeros((n, BLOCK)),
            np.zeros((n, BLOCK)),
            np.zeros((n, BLOCK)),
        )
        nothing, beyond, push = np.zeros((n, BLOCK)), np.zeros((n, BLOCK)), np.zeros(n)
        for lane in range(BLOCK):
            common[PERIOD, lane], common[IMPLICIT, lane] = period, 1.0 - 2.0 * alpha
        for j in range(n):
            for lane in range(BLOCK):
                u[j, lane], signals[MOBILITY, j, lane], signals[U_SCALE, j, lane] = (
                    issued[0, j],
                    1.0,
                    u_scale[j],
                )
        delayed, late = start(signals, common, memory, on, own, family)
        sent = np.zeros(
            (n, BLOCK), np.int64
        )  # the sample whose command is on its way to each joint
        seen = np.zeros((n, BLOCK), np.int64)  # the sample that each sensor shows
        passed = np.zeros((last + 1 if late else 0, 2 * n, BLOCK))
        parts, answers = parts_asked(on), answers_asked(on)
        for i in range(last + 1):
            if is_filter and i == 0:
                for j in range(n):
                    for lane in range(BLOCK):
                        q[j, lane], v[j, lane] = init[0, j, lane], init[0, n + j, lane]
            elif is_filter and resets[i] >= 0:
                start_as_first(i, signals, common, memory, on, own, passed, beyond)
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
                correct_first(i, gain, observed, push, signals, common, memory, on, own)
                if resets[i] >= 0:
                    for lane in range(1, BLOCK):
                        for j in range(n):
                            q[j, lane], v[j, lane] = q[j, 0], v[j, 0]
                            follow(j, signals, common, memory, on, own, lane)
            for j in range(n):
                for lane in range(BLOCK):
                    out[i, j, lane] = q_at[j, lane]
                    out[i, n + j, lane] = v_at[j, lane]
            for step in range(steps[i]):
                for lane in range(BLOCK):
                    common[H, lane] = h_s[i]
                for j in range(n):
                    for lane in range(BLOCK):
                        u[j, lane] = issued[i, j]
                    if delayed:
                        send_late(
                            j,
                            t_s[i] + step * h_s[i],
                            t_s[i] + (step + 1) * h_s[i],
                            h_s[i],
                            t_s,
                            issued,
                            integral,
                            signals,
                            sent,
                        )
                    if j == 0:
                        timing(j, signals, common, memory, on, own)
                    for lane in range(BLOCK):
                        q_at[j, lane] = q[j, lane] + alpha * common[H, lane] * v[j, lane]
                        v_at[j, lane] = v[j, lane]
                    servo = LINK * n + JOINT * j + SERVO
                    if (
                        family == TREE_FORM and p[servo, 0] != 0.0
                    ):  # effects change its goal, or its drive, which acts on the error
                        goal(j, signals, common, memory, on, own)
                        to_error(
                            u[j],
                            q_at[j],
                            p[servo],
                            p[LINK * n + JOINT * j + GAIN],
                            tree[j, OFFSET],
                            wide,
                        )
                        drive(j, signals, common, memory, on, own)
                        for lane in range(BLOCK):
                            u[j, lane] += wide[lane]
                    else:
                        command(j, signals, common, memory, on, own)
                nominal(signals, common, p, family, alpha, parts)
                if family == TREE_FORM:
                    accelerate(
                        p,
                        tree,
                        sizes,
                        alpha,
                        common,
                        q_at,
                        v,
                        v_at,
                        u,
                        a,
                        room,
                        mass,
                        moves,
                        wide,
                        forces,
                        beyond,
                    )
                    if parts:
                        part_forces(
                            p, tree, sizes, signals, q_at, v_at, room, moves, forces, free, nothing
                        )
                for j in range(n):
                    force(j, signals, common, memory, on, own)
                if family == TREE_FORM and answers:
                    pass_through_links(signals, sizes, moves, forces)
                for j in range(n):
                    answer(j, signals, common, memory, on, own)
                    if family == TREE_FORM:
                        for lane in range(BLOCK):
                            beyond[j, lane] = sizes[j] * a[j, lane] - forces[j, lane]
                    a[j, 0] += push[
                        j
                    ]  # of the filter alone: what disturbs the machine for a while is not foretold
                    for lane in range(BLOCK):
                        level[j, lane] = 0.0
                    friction(j, signals, common, memory, on, own)
                if family == TREE_FORM:
                    move_tree(p, sizes, alpha, signals, common, moves, held, free, forces)
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


def start_as_first(
    i: Any, signals: Any, common: Any, memory: Any, on: Any, own: Any, passed: Any, beyond: Any
) -> None:
    """A window's start as lane 0, the filter, has it."""
    for j in range(signals.shape[1]):
        for lane in range(1, BLOCK):
            signals[Q, j, lane], signals[V, j, lane], beyond[j, lane] = (
                signals[Q, j, 0],
                signals[V, j, 0],
                beyond[j, 0],
            )
            follow(j, signals, common, memory, on, own, lane)
    for k in range(min(i, len(passed))):
        for j in range(passed.shape[1]):
            for lane in range(1, BLOCK):
                passed[k, j, lane] = passed[k, j, 0]


def start_from(
    init: Any, starts: Any, signals: Any, common: Any, memory: Any, on: Any, own: Any, beyond: Any
) -> None:
    """A window's start from positions and velocities `(2 x joints, lanes)`; the hidden states of
    the first `starts` lanes are lane 0's."""
    n = signals.shape[1]
    for j in range(n):
        jump(j, signals, common, memory, on, own, init[n + j])
        for lane in range(1, 1 + starts):
            follow(j, signals, common, memory, on, own, lane)
        for lane in range(BLOCK):
            signals[Q, j, lane], signals[V, j, lane], beyond[j, lane] = (
                init[j, lane],
                init[n + j, lane],
                0.0,
            )


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
                x, q1, v1 = (
                    (when - t_s[k]) / span,
                    passed[k + 1, j, lane],
                    passed[k + 1, n + j, lane],
                )
                rest = (1.0 - x) * span * v0 - x * span * v1 + (1.0 - 2.0 * x) * (q0 - q1)
                signals[Q_AT, j, lane] = (1.0 - x) * q0 + x * q1 + x * (1.0 - x) * rest
                signals[V_AT, j, lane] = (1.0 - x) * v0 + x * v1


def correct_first(
    i: Any, gain: Any, observed: Any, push: Any, signals: Any, common: Any, memory: Any, on:
    Any, own: Any,
) -> None:  # fmt: skip
    """Lane 0, the filter, corrected by what was observed at a sample."""
    n, now = signals.shape[1], min(i, len(gain) - 1)
    for j in range(n):
        for c in range(2):
            if np.isfinite(observed[i, c * n + j]):
                missed = observed[i, c * n + j] - (
                    signals[Q_AT, j, 0] if c == 0 else signals[V_AT, j, 0]
                )
                if i == 0:  # the log's first sample is all that is known
                    signals[Q, j, 0] += missed if c == 0 else 0.0
                    signals[V, j, 0] += missed if c == 1 else 0.0
                else:
                    signals[Q, j, 0] += gain[now, j, 0, c] * missed
                    signals[V, j, 0] += gain[now, j, 1, c] * missed
                    push[j] += gain[now, j, 2, c] * missed
                    correct(
                        j,
                        signals,
                        common,
                        memory,
                        on,
                        own,
                        gain[now, j, 1, c],
                        gain[now, j, 3, c],
                        missed,
                    )


def send_late(
    j: Any, begins: Any, ends: Any, h_s: Any, t_s: Any, issued: Any, integral: Any, signals:
    Any, sent: Any,
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
        before = integral[k, j] + (issued[k, j] if when >= t_s[0] else signals[PAST, j, lane]) * (
            when - t_s[k]
        )
        when = ends - lag_s
        while k < last and t_s[k + 1] < when:
            k += 1
        reached = integral[k, j] + (issued[k, j] if when >= t_s[0] else signals[PAST, j, lane]) * (
            when - t_s[k]
        )
        signals[U, j, lane] = (reached - before) / h_s


def to_error(u: Any, q: Any, servo: Any, gains: Any, offset: Any, goal_here: Any) -> None:
    """A servo's command less the one that would hold it where it is, which `goal_here` keeps; all
    `(lanes,)`."""
    for lane in range(BLOCK):
        goal_here[lane] = (servo[lane] * q[lane] - offset) / gains[lane]
        u[lane] -= goal_here[lane]


def accelerate(
    p: Any, tree: Any, sizes: Any, alpha: Any, common: Any, q_at: Any, v: Any, v_at: Any, u: Any,
    a: Any,
    room: Any, mass: Any, moves: Any, wide: Any, forces: Any, beyond: Any,
) -> None:  # fmt: skip
    """Forces of a tree at each joint, as accelerations of the joint's own inertia, and the inverse
    mass matrix `moves`."""
    n = len(tree)
    pose(tree, p, q_at, room, mass)
    for j in range(n):
        own, damping = mass[j, j * BLOCK : (j + 1) * BLOCK], p[LINK * n + JOINT * j + DAMPING]
        for lane in range(BLOCK):
            own[lane] += (1.0 - alpha) * common[H, lane] * damping[lane]
    invert_lanes(mass, moves, wide)
    bias(tree, v, room, forces)
    net(tree, p, u, q_at, v, forces)
    if alpha > 0.0:
        for j in range(n):
            for k in range(n):
                to, by, here = v_at[j], moves[j, k * BLOCK : (k + 1) * BLOCK], forces[k]
                more = beyond[k]  # what effects did in the last step
                for lane in range(BLOCK):
                    to[lane] += alpha * common[H, lane] * by[lane] * (here[lane] + more[lane])
        bias(tree, v_at, room, forces)
        net(
            tree, p, u, q_at, v, forces
        )  # damping takes the velocity of the step's end, see the mass matrix
    for j in range(n):
        for lane in range(BLOCK):
            a[j, lane] = forces[j, lane] / sizes[j]


def part_forces(
    p: Any, tree: Any, sizes: Any, signals: Any, q_at: Any, v_at: Any, room: Any, moves: Any,
    forces: Any, free: Any, nothing: Any,
) -> None:  # fmt: skip
    """What effects ask of a tree's acceleration at each joint: the drive's part, the spring's, the
    passive one, and the mobility."""
    n = len(tree)
    bias(tree, v_at, room, free)
    net(tree, p, nothing, q_at, nothing, free)
    for j in range(n):
        gains, servo = p[LINK * n + JOINT * j + GAIN], p[LINK * n + JOINT * j + SERVO]
        for lane in range(BLOCK):  # a servo drives by its error
            idle = tree[j, OFFSET] - servo[lane] * q_at[j, lane]
            driven = min(
                max(idle + gains[lane] * signals[U, j, lane], -tree[j, LIMIT]), tree[j, LIMIT]
            )
            signals[DRIVE, j, lane] = driven / sizes[j]
            signals[SPRING, j, lane] = (
                free[j, lane] - min(max(idle, -tree[j, LIMIT]), tree[j, LIMIT])
            ) / sizes[j]
            signals[MOBILITY, j, lane] = moves[j, j * BLOCK + lane] * sizes[j]
            signals[PASSIVE, j, lane] = 0.0
        for k in range(n):
            for lane in range(BLOCK):
                signals[PASSIVE, j, lane] += moves[j, k * BLOCK + lane] * forces[k, lane]
        for lane in range(BLOCK):
            signals[PASSIVE, j, lane] = (
                signals[PASSIVE, j, lane] / signals[MOBILITY, j, lane] - signals[DRIVE, j, lane]
            )


def pass_through_links(signals: Any, sizes: Any, moves: Any, forces: Any) -> None:
    """What effects at the other joints do to a joint comes through the links."""
    n = len(forces)
    for j in range(n):
        for k in range(n):
            if k == j:
                continue
            for lane in range(BLOCK):
                more = signals[A, k, lane] * sizes[k] - forces[k, lane]
                signals[PASSIVE, j, lane] += (
                    moves[j, k * BLOCK + lane] * more / signals[MOBILITY, j, lane]
                )


def move_joint(alpha: Any, signals: Any, common: Any) -> None:
    """One joint's step: the kick, dry friction as a projection, the drift."""
    for lane in range(BLOCK):
        h = common[H, lane]
        after = signals[V, 0, lane] + h * signals[A, 0, lane]
        after = np.copysign(max(abs(after) - h * signals[LEVEL, 0, lane], 0.0), after)
        signals[V, 0, lane] = after
        signals[Q, 0, lane] = signals[Q_AT, 0, lane] + (1.0 - alpha) * h * after


def move_tree(
    p: Any, sizes: Any, alpha: Any, signals: Any, common: Any, moves: Any, held: Any, free: Any,
    impulse: Any,
) -> None:  # fmt: skip
    """A tree's step: the same, with dry friction of all joints at once."""
    n = len(free)
    for j in range(n):
        for lane in range(BLOCK):
            held[j, lane] = common[H, lane] * (
                sizes[j] * signals[LEVEL, j, lane] + p[LINK * n + JOINT * j + FRICTION, lane]
            )
            free[j, lane] = signals[V, j, lane]
        for k in range(n):
            to, by = free[j], moves[j, k * BLOCK : (k + 1) * BLOCK]
            for lane in range(BLOCK):
                to[lane] += common[H, lane] * by[lane] * sizes[k] * signals[A, k, lane]
    rub(moves, held, free, impulse)
    for j in range(n):
        for lane in range(BLOCK):
            signals[V, j, lane] = free[j, lane]
            signals[Q, j, lane] = (
                signals[Q_AT, j, lane] + (1.0 - alpha) * common[H, lane] * free[j, lane]
            )


for _function in (
    start, start_as_first, start_from, show_late, correct_first, send_late, to_error, accelerate,
    part_forces, pass_through_links,
    move_joint, move_tree,
):  # fmt: skip
    register_jitable(forceinline=True)(_function)  # compiled into the kernel
