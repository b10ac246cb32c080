"""One compiled rollout for every family with every effect.

The kernel is assembled from the text of the families and effects, once, and kept on disk until one of them changes. A
*block* is one hypothesis: BLOCK lanes that share which effects act and differ in parameters and initial states. Each
effect is a loop of its own over the lanes, in vector registers, entered only where the effect acts. So a hypothesis costs what
its own effects cost, and nothing is compiled for it.

    each episode runs from its first sample to its last; hidden states (lag, play, heat, hysteresis) run through
    at the start of a window, position and velocity are set, which is no motion; the rest keeps its past
    lanes that differ in their starts have lane 0's past at each of them, so that they show what a start does in its own window
    where lanes follow lane 0, lane 0 is corrected by each observation, in position, velocity, a force that disturbs it and what hides its
    velocity, and the others start each window from its whole state

Two schemes of integration: the declared one (semi-implicit Euler, alpha 0), and its symmetric form (alpha 1/2), in which
position drifts, velocity is kicked and position drifts, of second order. Source: E. Hairer, C. Lubich, G. Wanner, Geometric
Numerical Integration (2006), section I.3. Dry friction is a projection of the kicked velocity: J. J. Moreau (1988).
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable
from functools import cache
from typing import Any

import numpy as np
from numba import njit
from numba.extending import register_jitable

from trueup.model.block import BLOCK, height, memory_offsets, offsets
from trueup.model.effect import DELAYS, SIGNALS, Effect, Port, effects
from trueup.model.family import Family, families, source_digest
from trueup.model.rigid_body import ROOM, bias, invert_lanes, net, pose, rub
from trueup.model.tree import DAMPING, FRICTION, GAIN, JOINT, LIMIT, LINK, OFFSET, SERVO

APART = frozenset({"passive", "drive", "spring", "mobility"})  # parts of the nominal acceleration
RIGID = {f.__name__: f for f in (bias, invert_lanes, net, pose, rub)}
AT_JOINT = {"JOINT": JOINT, "DAMPING": DAMPING, "GAIN": GAIN, "SERVO": SERVO, "FRICTION": FRICTION}
NUMBERS = {"ROOM": ROOM, "LINK": LINK, "OFFSET": OFFSET, "LIMIT": LIMIT, **AT_JOINT}

HEAD = """
def make(digest, functions, njit):
    {unpack} = functions

    @njit(cache=True, nogil=True, error_model="numpy")
    def run(
        p, on, first, family, tree, sizes, alpha, u_scale, period, t_s, h_s, steps, issued, integral, resets, init, starts, follow, gain,
        observed, out,
    ):
        digest
        n = len(u_scale)
        q, v, u, a, level = np.zeros((n, W)), np.zeros((n, W)), np.zeros((n, W)), np.zeros((n, W)), np.zeros((n, W))
        passive, drive, spring = np.zeros((n, W)), np.zeros((n, W)), np.zeros((n, W))
        lag_s, late_s = np.zeros((n, W)), np.zeros((n, W))
        past, qe, ve, mobility = np.zeros((n, W)), np.zeros((n, W)), np.zeros((n, W)), np.ones((n, W))
        h, t = np.zeros(W), np.zeros(W)
        pointer = np.zeros((n, W), np.int64)
        room, mass, moves = np.zeros((n, ROOM * W)), np.zeros((n, n * W)), np.zeros((n, n * W))
        wide = np.zeros(n * W)
        forces, free, held, nothing, beyond = np.zeros((n, W)), np.zeros((n, W)), np.zeros((n, W)), np.zeros((n, W)), np.zeros((n, W))
        {states}
        last = len(t_s) - 1
        for j in range(n):
            for lane in range(W):
                u[j, lane] = issued[0, j]
        for j in range(n):
            o = first + j * HEIGHT
            {begin}
        delayed, late, push = False, False, np.zeros(n)
        implicit = 1.0 - 2.0 * alpha
        for j in range(n):
            o = first + j * HEIGHT
            {delays}
        for j in range(n):
            for lane in range(W):
                if family >= 0:  # on the log of one joint alone a late sensor is a late drive
                    lag_s[j, lane], late_s[j, lane] = lag_s[j, lane] + late_s[j, lane], 0.0
                late = late or late_s[j, lane] > 0.0
        passed, behind = np.zeros((last + 1 if late else 0, 2 * n, W)), np.zeros((n, W), np.int64)
        for i in range(last + 1):
            if follow and i == 0:
                for j in range(n):
                    for lane in range(W):
                        q[j, lane], v[j, lane] = init[0, j, lane], init[0, n + j, lane]
            elif follow and resets[i] >= 0:
                for j in range(n):
                    for lane in range(1, W):
                        q[j, lane], v[j, lane], beyond[j, lane] = q[j, 0], v[j, 0], beyond[j, 0]
                        {follow_states}
                if late:
                    for k in range(i):
                        for j in range(2 * n):
                            for lane in range(1, W):
                                passed[k, j, lane] = passed[k, j, 0]
            elif resets[i] >= 0:
                for j in range(n):
                    {jump}
                    for lane in range(1, 1 + starts):
                        {follow_states}
                    for lane in range(W):
                        q[j, lane], v[j, lane], beyond[j, lane] = init[resets[i], j, lane], init[resets[i], n + j, lane], 0.0
            since = t_s[i] - t_s[i - 1] if i > 0 else 0.0
            for lane in range(W):
                t[lane] = t_s[i]
            for j in range(n):
                o = first + j * HEIGHT
                for lane in range(W):
                    qe[j, lane], ve[j, lane] = q[j, lane], v[j, lane]
                if late:
                    for lane in range(W):
                        passed[i, j, lane], passed[i, n + j, lane] = q[j, lane], v[j, lane]
                        if late_s[j, lane] > 0.0:
                            at = t_s[i] - late_s[j, lane]
                            k = behind[j, lane]
                            while k < i - 1 and t_s[k + 1] <= at:
                                k += 1
                            behind[j, lane] = k
                            q0, v0 = passed[k, j, lane], passed[k, n + j, lane]
                            if at <= t_s[0] or i == 0:
                                qe[j, lane], ve[j, lane] = q0 + (at - t_s[0]) * v0, v0
                            else:
                                span = t_s[k + 1] - t_s[k]
                                x, q1, v1 = (at - t_s[k]) / span, passed[k + 1, j, lane], passed[k + 1, n + j, lane]
                                rest = (1.0 - x) * span * v0 - x * span * v1 + (1.0 - 2.0 * x) * (q0 - q1)
                                qe[j, lane] = (1.0 - x) * q0 + x * q1 + x * (1.0 - x) * rest
                                ve[j, lane] = (1.0 - x) * v0 + x * v1
                {observe}
            if follow:
                now = min(i, len(gain) - 1)
                for j in range(n):
                    for c in range(2):
                        if np.isfinite(observed[i, c * n + j]):
                            missed = observed[i, c * n + j] - (qe[j, 0] if c == 0 else ve[j, 0])
                            if i == 0:  # the log's first sample is all that is known
                                q[j, 0] += missed if c == 0 else 0.0
                                v[j, 0] += missed if c == 1 else 0.0
                            else:
                                q[j, 0] += gain[now, j, 0, c] * missed
                                v[j, 0] += gain[now, j, 1, c] * missed
                                push[j] += gain[now, j, 2, c] * missed
                                {hidden}
                    if resets[i] >= 0:
                        for lane in range(1, W):
                            q[j, lane], v[j, lane] = q[j, 0], v[j, 0]
                            {follow_states}
            for j in range(n):
                for lane in range(W):
                    out[i, j, lane] = qe[j, lane]
                    out[i, n + j, lane] = ve[j, lane]
            for step in range(steps[i]):
                for lane in range(W):
                    h[lane] = h_s[i]
                for j in range(n):
                    o = first + j * HEIGHT
                    for lane in range(W):
                        u[j, lane] = issued[i, j]
                    if delayed:
                        begin, end = t_s[i] + step * h_s[i], t_s[i] + (step + 1) * h_s[i]
                        for lane in range(W):
                            if lag_s[j, lane] <= 0.0:
                                continue
                            k = pointer[j, lane]
                            at = begin - lag_s[j, lane]
                            while k < last and t_s[k + 1] <= at:
                                k += 1
                            pointer[j, lane] = k
                            before = integral[k, j] + (issued[k, j] if at >= t_s[0] else past[j, lane]) * (at - t_s[k])
                            at = end - lag_s[j, lane]
                            while k < last and t_s[k + 1] < at:
                                k += 1
                            reached = integral[k, j] + (issued[k, j] if at >= t_s[0] else past[j, lane]) * (at - t_s[k])
                            u[j, lane] = (reached - before) / h_s[i]
                    if j == 0:
                        {timing}
                    for lane in range(W):
                        qe[j, lane] = q[j, lane] + alpha * h[lane] * v[j, lane]
                        ve[j, lane] = v[j, lane]
                    if family < 0 and p[LINK * n + JOINT * j + SERVO, 0] != 0.0:
                        {goal}
                        gains, servo = p[LINK * n + JOINT * j + GAIN], p[LINK * n + JOINT * j + SERVO]
                        for lane in range(W):
                            wide[lane] = (servo[lane] * qe[j, lane] - tree[j, OFFSET]) / gains[lane]
                            u[j, lane] -= wide[lane]
                        {drive}
                        for lane in range(W):
                            u[j, lane] += wide[lane]
                    else:
                        {command}
                {families}
                if family < 0:
                    pose(tree, p, qe, room, mass)
                    for j in range(n):
                        own, damping = mass[j, j * W : (j + 1) * W], p[LINK * n + JOINT * j + DAMPING]
                        for lane in range(W):
                            own[lane] += (1.0 - alpha) * h[lane] * damping[lane]
                    invert_lanes(mass, moves, wide)
                    bias(tree, v, room, forces)
                    net(tree, p, u, qe, v, forces)
                    if alpha > 0.0:
                        for j in range(n):
                            for k in range(n):
                                to, by, force = ve[j], moves[j, k * W : (k + 1) * W], forces[k]
                                more = beyond[k]  # what effects did in the last step
                                for lane in range(W):
                                    to[lane] += alpha * h[lane] * by[lane] * (force[lane] + more[lane])
                        bias(tree, ve, room, forces)
                        net(tree, p, u, qe, v, forces)
                    for j in range(n):
                        for lane in range(W):
                            a[j, lane] = forces[j, lane] / sizes[j]
                    if {apart}:
                        bias(tree, ve, room, free)
                        net(tree, p, nothing, qe, nothing, free)
                        for j in range(n):
                            gains, servo = p[LINK * n + JOINT * j + GAIN], p[LINK * n + JOINT * j + SERVO]
                            for lane in range(W):  # a servo drives by its error
                                idle = tree[j, OFFSET] - servo[lane] * qe[j, lane]
                                drive[j, lane] = min(max(idle + gains[lane] * u[j, lane], -tree[j, LIMIT]), tree[j, LIMIT]) / sizes[j]
                                spring[j, lane] = (free[j, lane] - min(max(idle, -tree[j, LIMIT]), tree[j, LIMIT])) / sizes[j]
                                mobility[j, lane] = moves[j, j * W + lane] * sizes[j]
                                passive[j, lane] = 0.0
                            for k in range(n):
                                for lane in range(W):
                                    passive[j, lane] += moves[j, k * W + lane] * forces[k, lane]
                            for lane in range(W):
                                passive[j, lane] = passive[j, lane] / mobility[j, lane] - drive[j, lane]
                for j in range(n):
                    o = first + j * HEIGHT
                    {force}
                if family < 0 and {answers}:  # what the others' effects do comes through the links
                    for j in range(n):
                        for k in range(n):
                            if k == j:
                                continue
                            for lane in range(W):
                                more = a[k, lane] * sizes[k] - forces[k, lane]
                                passive[j, lane] += moves[j, k * W + lane] * more / mobility[j, lane]
                for j in range(n):
                    o = first + j * HEIGHT
                    {behind}
                    if family < 0:
                        for lane in range(W):
                            beyond[j, lane] = sizes[j] * a[j, lane] - forces[j, lane]
                    a[j, 0] += push[j]  # of the filter alone: what disturbs the machine for a while is not foretold
                    for lane in range(W):
                        level[j, lane] = 0.0
                    {friction}
                if family >= 0:
                    for lane in range(W):
                        after = v[0, lane] + h[lane] * a[0, lane]
                        after = np.copysign(max(abs(after) - h[lane] * level[0, lane], 0.0), after)
                        v[0, lane] = after
                        q[0, lane] = qe[0, lane] + (1.0 - alpha) * h[lane] * after
                else:
                    for j in range(n):
                        for lane in range(W):
                            held[j, lane] = h[lane] * (sizes[j] * level[j, lane] + p[LINK * n + JOINT * j + FRICTION, lane])
                            free[j, lane] = v[j, lane]
                        for k in range(n):
                            to, by, force = free[j], moves[j, k * W : (k + 1) * W], a[k]
                            for lane in range(W):
                                to[lane] += h[lane] * by[lane] * sizes[k] * force[lane]
                    rub(moves, held, free, forces)
                    for j in range(n):
                        for lane in range(W):
                            v[j, lane] = free[j, lane]
                            q[j, lane] = qe[j, lane] + (1.0 - alpha) * h[lane] * free[j, lane]

    return run
"""


@cache
def kernel() -> Callable[..., None]:
    """The compiled rollout of one block over one episode.

    p `(rows, BLOCK)`; on `(effects, joints)`; first the row of the first joint's effects; family its number, -1 for a tree; tree
    `(joints, TREE)`; sizes `(joints,)` the inertia against which an effect's forces are measured; u_scale `(joints,)`; t_s, h_s, steps,
    resets (the window that starts at a sample, or -1) `(samples,)`; issued and its integral up to each sample `(samples, joints)`; init
    `(windows, 2 x joints, BLOCK)`; gain `(beginning, joints, 4, 2)`; observed `(samples, 2 x joints)`;
    writes out `(samples, 2 x joints, BLOCK)`.
    """
    functions, text = assemble(families(), effects())
    digest = ",".join(source_digest(f) for f in (*functions, pose))
    scope: dict[str, Any] = {"np": np, "W": BLOCK, "HEIGHT": height(), "__name__": __name__, **NUMBERS, **RIGID}
    exec(compile(text, __file__, "exec"), scope)  # noqa: S102  (the text is this file's own; see assemble)
    return scope["make"](digest, tuple(register_jitable(f) for f in functions), njit)  # type: ignore[no-any-return]


def assemble(known_families: dict[str, type[Family]], known_effects: dict[str, type[Effect]]) -> tuple[list[Callable[..., Any]], str]:
    """The functions to compile, and the text of the kernel that calls them."""
    functions = [f.acceleration for f in known_families.values()] + [e.apply for e in known_effects.values()]
    names = [f"family_{i}" for i in range(len(known_families))] + [f"effect_{i}" for i in range(len(known_effects))]
    parts = ("delays", "behind", "goal", "drive", "states", "begin", "follow_states", "hidden", "jump")
    ports: dict[str, list[str]] = {part: [] for part in (*Port, *parts)}
    for index, effect in enumerate(known_effects.values()):
        ports["delays" if effect.delays() else "behind" if _answers(effect) else str(effect.port)] += _loop(index, effect)
        if effect.port is Port.COMMAND and not effect.delays():  # a servo follows its goal, and its drive acts on the error
            ports["drive" if effect.of_drive else "goal"] += _loop(index, effect)
        if effect.hides_velocity:
            seen, before = (f"{state}_{index}" for state in effect.states)
            ports["hidden"] += [f"if on[{index}, j]:"]
            ports["hidden"] += [f"    {of}[j, 0] += gain[now, j, {at}, c] * missed" for of, at in ((seen, 3), (before, 1))]
            ports["jump"] += [f"if on[{index}, j]:", "    for lane in range(W):"]
            ports["jump"] += [f"        {before}[j, lane] += init[resets[i], n + j, lane] - v[j, lane]"]
        for state, begins in zip(effect.states, effect.begins, strict=True):
            ports["states"].append(f"{state}_{index} = np.zeros((n, W))")
            ports["follow_states"].append(f"{state}_{index}[j, lane] = {state}_{index}[j, 0]")
            if begins == "first":
                continue
            from_ = "" if begins == "zero" else f"{begins}[j, lane] + "
            row = memory_offsets()[effect.name, state]
            ports["begin"] += ["for lane in range(W):", f"    {state}_{index}[j, lane] = {from_}p[o + {row}, lane]"]
    apart, answers = (_any_on(known_effects.values(), asks) for asks in (_parts_force, _answers))
    ports["families"] = [line for i, f in enumerate(known_families.values()) for line in _family(i, f, apart)]
    ports["observe"] = ports.pop("observation")
    ports |= {"unpack": [", ".join(names)], "apart": [apart], "answers": [answers]}
    text = "\n".join(_fill(line, ports) for line in HEAD.splitlines())
    return functions, text


def _any_on(all_effects: Iterable[type[Effect]], asks: Callable[[type[Effect]], bool]) -> str:
    """Whether any of those effects acts that ask for something, in the kernel's words."""
    return " or ".join(f"on[{i}].any()" for i, e in enumerate(all_effects) if asks(e)) or "False"


def _parts_force(effect: type[Effect]) -> bool:
    """Whether an effect asks for a part of the nominal acceleration."""
    return bool(APART.intersection(effect.arguments()))


def _answers(effect: type[Effect]) -> bool:
    """Whether an effect answers all other forces at its joint, and so comes after them."""
    return effect.port is Port.FORCE and "passive" in effect.arguments()


def _fill(line: str, parts: dict[str, list[str]]) -> str:
    """A line of the frame, or the lines that stand for it, indented alike."""
    blank = line[: len(line) - len(line.lstrip())]
    for name, lines in parts.items():
        if line.strip() == "{" + name + "}":
            return "\n".join(blank + x for x in lines or ["pass"])
        line = line.replace("{" + name + "}", lines[0] if lines else "")
    return line


def _family(index: int, family: type[Family], apart: str) -> list[str]:
    """One family's loop over the lanes; its parts are told apart only where an effect asks for them."""
    values = "".join(f", p[{j}, lane]" for j in range(len(family.params)))
    call = f"family_{index}"
    return [
        f"if family == {index}:",
        "    for lane in range(W):",
        f"        ve[0, lane] += alpha * h[lane] * {call}(qe[0, lane], ve[0, lane], u[0, lane]{values})",
        f"        a[0, lane] = {call}(qe[0, lane], ve[0, lane], u[0, lane]{values})",
        f"    if {apart}:",
        "        for lane in range(W):",
        f"            passive[0, lane] = {call}(qe[0, lane], ve[0, lane], 0.0{values})",
        f"            spring[0, lane] = {call}(qe[0, lane], 0.0, 0.0{values})",
        "            drive[0, lane] = a[0, lane] - passive[0, lane]",
    ]


def _loop(index: int, effect: type[Effect]) -> list[str]:
    """One effect's loop over the lanes of a joint."""
    within = effect.port in (Port.FORCE, Port.FRICTION, Port.OBSERVATION)
    arrays = {"q": "qe", "v": "ve", "lag_s": "late_s"} if within else {}
    scalars = {"period", "since", "implicit"}
    common = {"h", "t"}  # to all joints
    rows = dict(zip((n.name for n in effect.params), offsets()[effect.name], strict=True))

    def signal(name: str) -> str:
        return f"{name}[lane]" if name in common else f"{arrays.get(name, name)}[j, lane]"

    def value(name: str) -> str:
        if name in rows:
            return f"p[o + {rows[name]}, lane]"
        if name in effect.states:
            return f"{name}_{index}[j, lane]"
        if name == "u_scale":
            return "u_scale[j]"
        return name if name in scalars else signal(name)

    signals = DELAYS if effect.delays() else SIGNALS[effect.port]
    results = ", ".join([signal(s) for s in signals] + [f"{s}_{index}[j, lane]" for s in effect.states])
    call = f"effect_{index}({', '.join(value(a) for a in inspect.signature(effect.apply).parameters)})"
    sign = "+=" if effect.port is Port.FRICTION else "="
    begin = ["    delayed = True"] if effect.delays() else []
    past = [f"        past[j, lane] = past_{index}[j, lane]"] if "past" in effect.states and not within else []
    return [f"if on[{index}, j]:", *begin, "    for lane in range(W):", f"        {results} {sign} {call}", *past]
