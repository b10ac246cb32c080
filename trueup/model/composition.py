"""One compiled rollout for every family with every effect.

The kernel is assembled from the text of the families and effects, once, and kept on disk until one of them changes. A
*block* is one hypothesis: BLOCK lanes that share which effects act and differ in parameters and initial states. Each
effect is a loop of its own over the lanes, in vector registers, entered only where the effect acts. So a hypothesis costs what
its own effects cost, and nothing is compiled for it.

    each episode runs from its first sample to its last; hidden states (lag, play, heat, hysteresis) run through
    at the start of a window, position and velocity are set, which is no motion; the rest keeps its past
    where lanes follow lane 0, lane 0 is corrected by each observation, in position, velocity, a force that disturbs it and what hides its
    velocity, and the others start each window from its whole state

Two schemes of integration: the declared one (semi-implicit Euler, alpha 0), and its symmetric form (alpha 1/2), in which
position drifts, velocity is kicked and position drifts, of second order. Source: E. Hairer, C. Lubich, G. Wanner, Geometric
Numerical Integration (2006), section I.3. Dry friction is a projection of the kicked velocity: J. J. Moreau (1988).
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
from numba import njit
from numba.extending import register_jitable

from trueup.model.block import BLOCK, memories, rows_of
from trueup.model.effect import DELAYS, SIGNALS, Effect, Port, effects
from trueup.model.family import Family, families, source_digest

APART = frozenset({"passive", "drive", "spring"})  # parts of the nominal acceleration

HEAD = """
def make(digest, functions, njit):
    {unpack} = functions

    @njit(cache=True, nogil=True, error_model="numpy")
    def run(p, on, family, alpha, u_scale, period, t_s, h_s, steps, issued, integral, resets, init, follow, gain, observed, out):
        digest
        q, v, u, a, h, t, level = np.zeros(W), np.zeros(W), np.zeros(W), np.zeros(W), np.zeros(W), np.zeros(W), np.zeros(W)
        passive, drive, spring, lag_s = np.zeros(W), np.zeros(W), np.zeros(W), np.zeros(W)
        past, qe, ve = np.zeros(W), np.zeros(W), np.zeros(W)
        pointer = np.zeros(W, np.int64)
        {states}
        last = len(t_s) - 1
        for lane in range(W):
            u[lane] = issued[0]
        {begin}
        delayed, push = False, 0.0
        implicit = 1.0 - 2.0 * alpha
        {delays}
        for i in range(last + 1):
            if follow and i == 0:
                for lane in range(W):
                    q[lane], v[lane] = init[0, 0, lane], init[0, 1, lane]
            elif follow and resets[i] >= 0:
                for lane in range(1, W):
                    q[lane], v[lane] = q[0], v[0]
                    {follow_states}
            elif resets[i] >= 0:
                {jump}
                for lane in range(W):
                    q[lane], v[lane] = init[resets[i], 0, lane], init[resets[i], 1, lane]
            since = t_s[i] - t_s[i - 1] if i > 0 else 0.0
            for lane in range(W):
                t[lane] = t_s[i]
                qe[lane], ve[lane] = q[lane], v[lane]
            {observe}
            if follow:
                now = min(i, len(gain) - 1)
                for c in range(gain.shape[2]):
                    if np.isfinite(observed[i, c]):
                        missed = observed[i, c] - (qe[0] if c == 0 else ve[0])
                        if i == 0:  # the log's first sample is all that is known
                            q[0] += missed if c == 0 else 0.0
                            v[0] += missed if c == 1 else 0.0
                        else:
                            q[0] += gain[now, 0, c] * missed
                            v[0] += gain[now, 1, c] * missed
                            push += gain[now, 2, c] * missed
                            {hidden}
                if resets[i] >= 0:
                    for lane in range(1, W):
                        q[lane], v[lane] = q[0], v[0]
                        {follow_states}
            for lane in range(W):
                out[i, 0, lane] = qe[lane]
                out[i, 1, lane] = ve[lane]
            for step in range(steps[i]):
                for lane in range(W):
                    h[lane] = h_s[i]
                    u[lane] = issued[i]
                if delayed:
                    begin, end = t_s[i] + step * h_s[i], t_s[i] + (step + 1) * h_s[i]
                    for lane in range(W):
                        if lag_s[lane] <= 0.0:
                            continue
                        k = pointer[lane]
                        at = begin - lag_s[lane]
                        while k < last and t_s[k + 1] <= at:
                            k += 1
                        pointer[lane] = k
                        before = integral[k] + (issued[k] if at >= t_s[0] else past[lane]) * (at - t_s[k])
                        at = end - lag_s[lane]
                        while k < last and t_s[k + 1] < at:
                            k += 1
                        u[lane] = (integral[k] + (issued[k] if at >= t_s[0] else past[lane]) * (at - t_s[k]) - before) / h_s[i]
                {timing}
                {command}
                for lane in range(W):
                    qe[lane] = q[lane] + alpha * h[lane] * v[lane]
                    ve[lane] = v[lane]
                {families}
                {force}
                a[0] += push  # of the filter alone: what disturbs the machine for a while is not foretold
                for lane in range(W):
                    level[lane] = 0.0
                {friction}
                for lane in range(W):
                    after = v[lane] + h[lane] * a[lane]
                    after = np.copysign(max(abs(after) - h[lane] * level[lane], 0.0), after)
                    v[lane] = after
                    q[lane] = qe[lane] + (1.0 - alpha) * h[lane] * after

    return run
"""


@cache
def kernel() -> Callable[..., None]:
    """The compiled rollout of one block over one episode.

    p `(parameters, BLOCK)`; on `(effects,)`; t_s, h_s, steps, issued, integral (of the command, up to each sample), resets (the window
    that starts at a sample, or -1) `(samples,)`; init `(windows, 2, BLOCK)`; gain `(beginning, 4, channels)`; observed `(samples,
    channels)`;
    writes out `(samples, 2, BLOCK)`.
    """
    functions, text = assemble(families(), effects())
    digest = ",".join(source_digest(f) for f in functions)
    scope: dict[str, Any] = {"np": np, "W": BLOCK, "__name__": __name__}
    exec(compile(text, __file__, "exec"), scope)  # noqa: S102  (the text is this file's own; see assemble)
    return scope["make"](digest, tuple(register_jitable(f) for f in functions), njit)  # type: ignore[no-any-return]


def assemble(known_families: dict[str, type[Family]], known_effects: dict[str, type[Effect]]) -> tuple[list[Callable[..., Any]], str]:
    """The functions to compile, and the text of the kernel that calls them."""
    functions = [f.acceleration for f in known_families.values()] + [e.apply for e in known_effects.values()]
    names = [f"family_{i}" for i in range(len(known_families))] + [f"effect_{i}" for i in range(len(known_effects))]
    ports: dict[str, list[str]] = {part: [] for part in (*Port, "delays", "states", "begin", "follow_states", "hidden", "jump")}
    for index, effect in enumerate(known_effects.values()):
        ports["delays" if effect.delays() else str(effect.port)] += _loop(index, effect)
        if effect.hides_velocity:
            seen, before = (f"{state}_{index}" for state in effect.states)
            ports["hidden"] += [f"if on[{index}]:"]
            ports["hidden"] += [f"    {of}[0] += gain[now, {at}, c] * missed" for of, at in ((seen, 3), (before, 1))]
            ports["jump"] += [f"if on[{index}]:", "    for lane in range(W):"]
            ports["jump"] += [f"        {before}[lane] += init[resets[i], 1, lane] - v[lane]"]
        for state, begins in zip(effect.states, effect.begins, strict=True):
            ports["states"].append(f"{state}_{index} = np.zeros(W)")
            ports["follow_states"].append(f"{state}_{index}[lane] = {state}_{index}[0]")
            if begins == "first":
                continue
            from_ = "" if begins == "zero" else f"{begins}[lane] + "
            ports["begin"] += ["for lane in range(W):", f"    {state}_{index}[lane] = {from_}p[{memories()[effect.name, state]}, lane]"]
    asking = [f"on[{i}]" for i, e in enumerate(known_effects.values()) if APART.intersection(e.arguments())]
    apart = " or ".join(asking) or "False"
    ports["families"] = [line for i, f in enumerate(known_families.values()) for line in _family(i, f, apart)]
    ports["observe"] = ports.pop("observation")
    text = "\n".join(_fill(line, ports | {"unpack": [", ".join(names)]}) for line in HEAD.splitlines())
    return functions, text


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
        f"        ve[lane] += alpha * h[lane] * {call}(qe[lane], ve[lane], u[lane]{values})",
        f"        a[lane] = {call}(qe[lane], ve[lane], u[lane]{values})",
        f"    if {apart}:",
        "        for lane in range(W):",
        f"            passive[lane] = {call}(qe[lane], ve[lane], 0.0{values})",
        f"            spring[lane] = {call}(qe[lane], 0.0, 0.0{values})",
        "            drive[lane] = a[lane] - passive[lane]",
    ]


def _loop(index: int, effect: type[Effect]) -> list[str]:
    """One effect's loop over the lanes."""
    within = effect.port in (Port.FORCE, Port.FRICTION, Port.OBSERVATION)
    arrays = {"q": "qe", "v": "ve"} if within else {}
    scalars = {"u_scale", "period", "since", "implicit"}
    rows = rows_of(effect.name)

    def value(name: str) -> str:
        if name in rows:
            return f"p[{rows[name]}, lane]"
        if name in effect.states:
            return f"{name}_{index}[lane]"
        return name if name in scalars else f"{arrays.get(name, name)}[lane]"

    signals = DELAYS if effect.delays() else SIGNALS[effect.port]
    results = ", ".join([f"{arrays.get(s, s)}[lane]" for s in signals] + [f"{s}_{index}[lane]" for s in effect.states])
    call = f"effect_{index}({', '.join(value(a) for a in inspect.signature(effect.apply).parameters)})"
    sign = "+=" if effect.port is Port.FRICTION else "="
    begin = ["    delayed = True"] if effect.delays() else []
    past = [f"        past[lane] = past_{index}[lane]"] if "past" in effect.states else []
    return [f"if on[{index}]:", *begin, "    for lane in range(W):", f"        {results} {sign} {call}", *past]
