"""The compiled rollout of one block over episodes, for every family and every tree with every
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
from trueup.model.dry_friction import project_friction
from trueup.model.dynamics import TREE_FORM
from trueup.model.family import source_digest
from trueup.model.inverse import invert_lanes
from trueup.model.kernel_sample import (
    correct_filters,
    place_at,
    send_late,
    show_late,
    start_as_filters,
    start_from,
)
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
    at,
    begin,
    command,
    delays,
    drive,
    follow,
    force,
    friction,
    goal,
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

    p `(episodes, rows, BLOCK)`; on `(effects, joints)`; first the row of the first joint's effects;
    family its number, -1 for a tree; tree `(joints, TREE)`; sizes `(joints,)` the inertia against
    which an effect's forces are measured; u_scale `(joints,)`; periods `(episodes,)`; ends
    `(episodes + 1,)` the first sample of each episode, and the number of all; t_s, h_s, steps,
    resets (the window that starts at a sample, or -1) `(samples,)`; issued, the mean command until
    the next sample, its rise meanwhile and its integral up to each sample `(samples, joints)`; init
    `(windows, 2 x joints, BLOCK)`, or of filters `(episodes, 2 x joints, BLOCK)`; gain `(beginning,
    joints, 4, 2, FILTERS)`; observed `(samples, 2 x joints)`; writes out `(samples, 2 x joints,
    BLOCK)`.
    """
    return _compiled(
        ",".join(
            (
                ports.digest(),
                source_digest(crba),
                source_digest(accelerate),
                source_digest(place_at),
                source_digest(invert_lanes),
                source_digest(project_friction),
            )
        )
    )


def _compiled(made_of: str) -> Callable[..., None]:
    """The kernel as the compiler keeps it: under this file's stamp, and under the digest of what it
    calls."""

    @njit(cache=True, nogil=True, error_model="numpy")
    def run(  # type: ignore[no-untyped-def]
        p, on, first, family, tree, sizes, alpha, u_scale, periods, ends, t_s, h_s, steps, issued,
        rise, integral, resets, init, starts, is_filter, gain, observed, out,
    ):  # fmt: skip
        made_of  # noqa: B018  (part of the cache's key)
        n = len(u_scale)
        for e in range(len(p)):
            of, nominal_p = slice(ends[e], ends[e + 1]), p[e, :first].reshape(-1)
            own = p[e, first:].reshape((n, -1))  # the effects' parameters, joint by joint
            signals, common = np.zeros((n, AT_JOINT * BLOCK)), np.zeros(OF_ALL * BLOCK)
            memory = np.zeros((n, MEMORY * BLOCK))
            delayed, late = start(
                signals, common, memory, on, own, family, alpha, u_scale, periods[e],
                issued[ends[e]],
            )  # fmt: skip
            of_tree = (
                np.zeros((n, LINK_ROWS * BLOCK)), np.zeros((n, n * BLOCK)),
                np.zeros((2, n * BLOCK)), np.zeros((2, BLOCK)), np.zeros((4, n, BLOCK)),
                np.zeros((5, n, BLOCK)),
            )  # fmt: skip
            # samples: whose command is on its way to each joint, and that each sensor shows
            sent, seen = np.zeros((n, BLOCK), np.int64), np.zeros((n, BLOCK), np.int64)
            passed = np.zeros((ends[e + 1] - ends[e] if late else 0, 2 * n, BLOCK))
            begun, push = init[e if is_filter else 0], np.zeros((n, FILTERS))
            episode(
                p[e], nominal_p, on, own, family, tree, sizes, alpha, t_s[of], h_s[of], steps[of],
                issued[of], rise[of], integral[of], resets[of], init, begun, starts, is_filter,
                gain, observed[of], out[of], signals, common, memory, of_tree, delayed, late, sent,
                seen, passed, push,
            )  # fmt: skip

    return run  # type: ignore[no-any-return]


def roll_episode(
    p: Any, nominal_p: Any, on: Any, own: Any, family: Any, tree: Any, sizes: Any, alpha: Any,
    t_s: Any, h_s: Any, steps: Any, issued: Any, rise: Any, integral: Any, resets: Any, init: Any,
    begun: Any, starts: Any, is_filter: Any, gain: Any, observed: Any, out: Any, signals: Any,
    common: Any, memory: Any, of_tree: Any, delayed: Any, late: Any, sent: Any, seen: Any,
    passed: Any, push: Any,
) -> None:  # fmt: skip
    """The rollout of one episode of the stack from its first sample, whose filters begin at
    `begun`."""
    n, last = len(sizes), len(t_s) - 1
    links, inverse_mass, room, lanes, motion, joints = of_tree
    holding, by = lanes[0], lanes[1]
    forces, free, held, nothing, beyond = joints[0], joints[1], joints[2], joints[3], joints[4]
    parts, answers = parts_asked(on), answers_asked(on)
    for i in range(last + 1):
        if is_filter and i == 0:
            for j in range(n):
                place_at(signals[j], begun[j], begun[n + j])
        elif is_filter and resets[i] >= 0:
            start_as_filters(i, signals, common, memory, on, own, passed, beyond)
        elif resets[i] >= 0:
            start_from(init[resets[i]], starts, signals, common, memory, on, own, beyond)
        now, since, h, span = t_s[i], t_s[i] - t_s[i - 1] if i > 0 else 0.0, h_s[i], steps[i]
        for lane in range(BLOCK):
            common[at(T, lane)], common[at(SINCE, lane)] = now, since
        for j in range(n):
            here = signals[j]
            for lane in range(BLOCK):
                here[at(Q_AT, lane)], here[at(V_AT, lane)] = here[at(Q, lane)], here[at(V, lane)]
            if late:
                show_late(i, j, t_s, here, passed, seen)
            observe(j, signals, common, memory, on, own)
        if is_filter:
            correct_filters(i, gain, observed, push, signals, common, memory, on, own)
            if resets[i] >= 0:
                for j in range(n):
                    here = signals[j]
                    for lane in range(FILTERS, BLOCK):
                        of = lane - FILTERS
                        here[at(Q, lane)], here[at(V, lane)] = here[at(Q, of)], here[at(V, of)]
                        follow(j, signals, common, memory, on, own, of, lane)
        for j in range(n):
            here, shown, speed = signals[j], out[i, j], out[i, n + j]
            for lane in range(BLOCK):
                shown[lane] = here[at(Q_AT, lane)]
            for lane in range(BLOCK):
                speed[lane] = here[at(V_AT, lane)]
        for step in range(span):
            # what happens at one time changes the length of a step for that step alone
            for lane in range(BLOCK):
                common[at(H, lane)] = h
            for j in range(n):
                here = signals[j]
                sent_now = issued[i, j] + rise[i, j] * ((step + 0.5) / span - 0.5)
                for lane in range(BLOCK):
                    here[at(U, lane)] = sent_now
                if delayed:
                    begins, ends = now + step * h, now + (step + 1) * h
                    send_late(j, begins, ends, h, t_s, issued, integral, here, sent)
                if j == 0:
                    timing(j, signals, common, memory, on, own)
                for lane in range(BLOCK):
                    v = here[at(V, lane)]
                    here[at(Q_AT, lane)] = here[at(Q, lane)] + alpha * common[at(H, lane)] * v
                    here[at(V_AT, lane)] = v
                first = LINK * n + JOINT * j
                if family == TREE_FORM and p[first + SERVO, 0] != 0.0:
                    # effects change a servo's goal, or its drive, which acts on the error
                    goal(j, signals, common, memory, on, own)
                    to_error(here, p[first + SERVO], p[first + GAIN], tree[j, OFFSET], holding)
                    drive(j, signals, common, memory, on, own)
                    for lane in range(BLOCK):
                        here[at(U, lane)] += holding[lane]
                else:
                    command(j, signals, common, memory, on, own)
            if family == TREE_FORM:
                accelerate(
                    p, tree, sizes, alpha, common, signals, links, inverse_mass, room, motion,
                    forces, beyond,
                )  # fmt: skip
                if parts:
                    part_forces(
                        p, tree, sizes, signals, links, inverse_mass, motion, forces, free, nothing,
                    )  # fmt: skip
            else:
                nominal(signals[0], common, nominal_p, family, alpha, parts)
            for j in range(n):
                force(j, signals, common, memory, on, own)
            if family == TREE_FORM and answers:
                pass_through_links(signals, sizes, inverse_mass, forces)
            for j in range(n):
                answer(j, signals, common, memory, on, own)
                here = signals[j]
                if family == TREE_FORM:
                    size, added, force_here = sizes[j], beyond[j], forces[j]
                    for lane in range(BLOCK):
                        added[lane] = size * here[at(A, lane)] - force_here[lane]
                if is_filter:
                    # of filters alone: what disturbs the machine for a while is not foretold
                    for lane in range(FILTERS):
                        here[at(A, lane)] += push[j, lane]
                for lane in range(BLOCK):
                    here[at(LEVEL, lane)] = 0.0
                friction(j, signals, common, memory, on, own)
            if family == TREE_FORM:
                move_tree(p, sizes, alpha, signals, common, inverse_mass, held, free, forces, by)
            else:
                move_joint(alpha, signals[0], common)


def start(
    signals: Any, common: Any, memory: Any, on: Any, own: Any, family: Any, alpha: Any,
    u_scale: Any, period: Any, issued: Any,
) -> Any:  # fmt: skip
    """Signals, hidden states and delays before the first sample, of which `issued` `(joints,)` is
    the command; whether commands are late, and whether a sensor is."""
    delayed, late, n = False, False, len(signals)
    for lane in range(BLOCK):
        common[at(PERIOD, lane)], common[at(IMPLICIT, lane)] = period, 1.0 - 2.0 * alpha
    for j in range(n):
        for lane in range(BLOCK):
            signals[j, at(U, lane)], signals[j, at(MOBILITY, lane)] = issued[j], 1.0
            signals[j, at(U_SCALE, lane)] = u_scale[j]
    for j in range(n):
        begin(j, signals, common, memory, on, own)
    for j in range(n):
        any_on = delays(j, signals, common, memory, on, own)
        delayed = delayed or any_on
    for j in range(n):
        here = signals[j]
        for lane in range(BLOCK):
            if family != TREE_FORM:  # on the log of one joint alone a late sensor is a late drive
                here[at(LAG_S, lane)] = here[at(LAG_S, lane)] + here[at(LATE_S, lane)]
                here[at(LATE_S, lane)] = 0.0
            late = late or here[at(LATE_S, lane)] > 0.0
    return delayed, late


register_jitable(forceinline=True)(start)  # compiled into the kernel

# Without counts of references: each view of an array would add to them and take from them again,
# which was a fifth of a rollout. So nothing is allocated inside of it.
episode = njit(nogil=True, error_model="numpy", _nrt=False)(roll_episode)
