"""Machine: one joint with known imperfections, integrated on a step far finer than its log.

Written apart from the models that are fitted to what it produces, and on purpose in other laws: velocity-verlet steps, friction
after Karnopp with an exponential Stribeck curve, Bouc-Wen hysteresis of exponent 2, a one-way damped stop. What resists a motion is
taken at the middle of a fine step, as the last step foretells it.
Sources: D. Karnopp, ASME Journal of Dynamic Systems 107 (1985); R. Bouc (1967), Y.-K. Wen (1976).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]

INERTIA, OSCILLATOR, PENDULUM = 0, 1, 2
KINDS = {"inertia": INERTIA, "oscillator": OSCILLATOR, "pendulum": PENDULUM}

# Where each imperfection's numbers lie in the vector that the simulation reads.
SLOTS: Mapping[str, tuple[str, ...]] = {
    "coulomb_friction": ("level",),
    "stribeck_friction": ("level", "extra", "speed"),
    "quadratic_drag": ("coefficient",),
    "cubic_stiffness": ("coefficient",),
    "constant_force": ("level",),
    "hysteresis": ("level", "distance"),
    "hard_stop": ("limit", "stiffness", "damping"),
    "cogging": ("amplitude", "pitch", "phase"),
    "elastic_transmission": ("stiffness", "damping", "share"),
    "load_dependent_friction": ("coefficient",),
    "asymmetric_viscous_friction": ("difference",),
    "deadband": ("width",),
    "backlash": ("gap",),
    "actuator_lag": ("time_constant",),
    "actuator_delay": ("delay",),
    "saturation": ("limit",),
    "rate_limit": ("rate",),
    "thermal_derating": ("loss", "time_constant"),
    "gain_asymmetry": ("asymmetry",),
    "command_quantization": ("step",),
    "quadratic_gain": ("odd", "even"),
    "sensor_delay": ("delay",),
    "sensor_bias": ("bias",),
    "sensor_scale": ("error",),
    "sensor_quantization": ("step", "velocity_step"),
    "sensor_drift": ("rate",),
    "velocity_lag": ("time_constant",),
    "clock_skew": ("skew",),
    "dropped_frames": ("fraction",),
    # beyond the catalogue: what a diagnosis must refuse to name
    "k_modulated": ("depth", "rate"),
    "van_der_pol": ("strength", "width"),
    "position_damping": ("coefficient",),
    "torque_speed": ("loss",),
    "hidden_mode": ("stiffness", "damping", "share"),
    "viscoelastic": ("stiffness", "time_constant"),
    "asymmetric_stiffness": ("change",),
    "growing_friction": ("rate",),
}
BEYOND = tuple(list(SLOTS)[-8:])
FIRST = dict(zip(SLOTS, np.cumsum([0] + [len(v) for v in SLOTS.values()])[:-1], strict=True))
SIZE = sum(len(v) for v in SLOTS.values())
(S_COULOMB, S_STRIBECK, S_DRAG, S_CUBIC, S_FORCE, S_HYST, S_STOP, S_COG, S_ELASTIC, S_LOAD, S_VASYM, S_DEAD, S_PLAY, S_LAG, S_DELAY,
 S_SAT, S_RATE, S_HEAT, S_ASYM, S_CQUANT, S_QGAIN, S_SDELAY, S_BIAS, S_SCALE, S_SQUANT, S_DRIFT, S_VLAG, S_SKEW, S_DROP, S_KMOD, S_VDP,
 S_PDAMP, S_SPEED, S_MODE, S_VISCO, S_ASTIFF, S_GROW) = (int(FIRST[name]) for name in SLOTS)  # fmt: skip


@dataclass(frozen=True)
class Machine:
    """A joint: its kind, its true k, c, b (per unit mass), its command limit, and what else is wrong with it.

    `bounds` are the command's limits where they are not +-limit.
    """

    kind: str
    k: float
    c: float
    b: float
    limit: float
    imperfections: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    bounds: tuple[float, float] | None = None

    def vector(self) -> tuple[Array, NDArray[np.bool_]]:
        """The imperfections' numbers, and which there are."""
        numbers, present = np.zeros(SIZE), np.zeros(SIZE, np.bool_)
        for name, values in self.imperfections.items():
            for offset, key in enumerate(SLOTS[name]):
                numbers[FIRST[name] + offset] = values[key]
                present[FIRST[name] + offset] = True
        return numbers, present


@dataclass(frozen=True)
class Run:
    """A log: sample times [s] `(n,)`, issued commands `(n,)`, observed position and velocity `(n, 2)`."""

    t_s: Array
    issued: Array
    observed: Array


@dataclass(frozen=True)
class Feedback:
    """u = kp (reference - position) - kd velocity, on observed values."""

    kp: float
    kd: float


def run(
    machine: Machine, planned: Array, timestep_s: float, parts: int, sigma: tuple[float, float], rng: np.random.Generator,
    start: tuple[float, float] = (0.0, 0.0), warm_up: int = 0, feedback: Feedback | None = None,
) -> Run:  # fmt: skip
    """Run a machine on planned commands, or references with feedback, `(warm_up + n,)`; the log begins after the warm-up.

    `parts` fine steps make a sample; with one, the step is the plain semi-implicit one of a discrete-time plant.
    """
    numbers, present = machine.vector()
    total = len(planned)
    noise = rng.normal(size=(total, 2)) * np.array(sigma)
    lost = rng.random(total)
    low, high = machine.bounds or (-machine.limit, machine.limit)
    gains = (feedback.kp, feedback.kd) if feedback else (0.0, 0.0)
    issued, observed = _run(
        KINDS[machine.kind], machine.k, machine.c, machine.b, low, high, machine.limit, numbers, present, np.ascontiguousarray(planned),
        timestep_s, parts,
        noise, lost, start[0], start[1], warm_up, feedback is not None, gains[0], gains[1],
    )  # fmt: skip
    kept = slice(warm_up, total)
    return Run(np.asarray(np.arange(total - warm_up) * timestep_s, np.float64), issued[kept].copy(), observed[kept].copy())


@njit(cache=True)
def _run(kind, k, c, b, low, high, limit, n, has, planned, dt, parts, noise, lost, q, v, warm_up, closed, kp, kd):  # type: ignore[no-untyped-def]
    total = len(planned)
    period = dt * (1.0 + n[S_SKEW])
    h = period / parts
    issued, observed = np.zeros(total), np.zeros((total, 2))
    fine_q, fine_v = np.zeros(total * parts + 1), np.zeros(total * parts + 1)
    wait_u, wait_y = int(n[S_DELAY] / h), int(n[S_SDELAY] / h)
    rest_u, rest_y = n[S_DELAY] / h - wait_u, n[S_SDELAY] / h - wait_y
    gained = 0.0
    fine_u = np.zeros(total * parts + 1)
    play = lag = rate = wind = heat = 0.0
    twist, twist_speed, mode, mode_speed, creep = 0.0, 0.0, 0.0, 0.0, 0.0
    fine_q[0], fine_v[0], slow = q, v, v
    for i in range(total):
        # what the sensors say
        past = max(0, i * parts - wait_y)
        before = max(0, past - 1)
        seen_q = (1.0 - rest_y) * fine_q[past] + rest_y * fine_q[before]
        seen_v = (1.0 - rest_y) * fine_v[past] + rest_y * fine_v[before]
        now = (i - warm_up) * dt
        seen_q = seen_q * (1.0 + n[S_SCALE]) + n[S_BIAS] + n[S_DRIFT] * max(now, 0.0)
        seen_q, seen_v = seen_q + noise[i, 0], seen_v + noise[i, 1]
        if has[S_SQUANT]:
            seen_q = n[S_SQUANT] * np.floor(seen_q / n[S_SQUANT] + 0.5)
            if n[S_SQUANT + 1] > 0.0:
                seen_v = n[S_SQUANT + 1] * np.floor(seen_v / n[S_SQUANT + 1] + 0.5)
        if has[S_DROP] and i > 0 and lost[i] < n[S_DROP]:
            seen_q, seen_v = observed[i - 1, 0], observed[i - 1, 1]
        observed[i, 0], observed[i, 1] = seen_q, seen_v
        u = kp * (planned[i] - seen_q) - kd * seen_v if closed else planned[i]
        issued[i] = min(max(u, low), high)
        for part in range(parts):
            j = i * parts + part
            fine_u[j] = issued[i]
            u = (1.0 - rest_u) * fine_u[max(0, j - wait_u)] + rest_u * fine_u[max(0, j - wait_u - 1)]
            # the drive
            if has[S_CQUANT]:
                u = n[S_CQUANT] * np.floor(u / n[S_CQUANT] + 0.5)
            if has[S_SAT]:
                u = min(max(u, -n[S_SAT]), n[S_SAT])
            if has[S_RATE]:
                change = u - rate
                most = n[S_RATE] * h
                later = u if abs(change) <= most else rate + (most if change > 0.0 else -most)
                u = later if parts == 1 else 0.5 * (rate + later)
                rate = later
            if has[S_DEAD]:
                u = 0.0 if abs(u) <= n[S_DEAD] else (u - n[S_DEAD] if u > 0.0 else u + n[S_DEAD])
            if has[S_PLAY]:
                half = n[S_PLAY] / 2.0
                if u - play > half:
                    play = u - half
                elif play - u > half:
                    play = u + half
                u = play
            if has[S_LAG]:
                later = lag + (u - lag) * (1.0 - np.exp(-h / n[S_LAG]))
                u = later if parts == 1 else 0.5 * (lag + later)
                lag = later
            if has[S_ASYM]:
                u = u * (1.0 + n[S_ASYM]) if u > 0.0 else u * (1.0 - n[S_ASYM])
            if has[S_HEAT]:
                heat += h * ((u / limit) ** 2 - heat) / n[S_HEAT + 1]
                u = u * max(0.05, 1.0 - n[S_HEAT] * heat)
            if has[S_QGAIN]:
                u = u * (1.0 + (n[S_QGAIN] * abs(u) + n[S_QGAIN + 1] * u) / limit)
            # forces on the joint at rest of its friction
            x = q if parts == 1 else q + 0.5 * h * v
            w = v if parts == 1 else v + 0.5 * gained
            stiffness = k
            if has[S_KMOD]:
                stiffness = k * (1.0 + n[S_KMOD] * np.sin(n[S_KMOD + 1] * now))
            if has[S_ASTIFF]:
                stiffness = k * (1.0 + n[S_ASTIFF]) if x > 0.0 else k * (1.0 - n[S_ASTIFF])
            spring = 0.0 if kind == 0 else (-stiffness * x if kind == 1 else -stiffness * np.sin(x))
            drive = b * u * (1.0 - n[S_SPEED] * abs(w))
            damping = c + n[S_VASYM] if w > 0.0 else c - n[S_VASYM]
            force = spring + n[S_FORCE] - n[S_DRAG] * w * abs(w) - n[S_CUBIC] * x**3
            if has[S_COG]:
                force += n[S_COG] * np.sin(2.0 * np.pi * x / n[S_COG + 1] + n[S_COG + 2])
            if has[S_VDP]:
                force -= n[S_VDP] * ((x / n[S_VDP + 1]) ** 2 - 1.0) * w
            if has[S_PDAMP]:
                force -= n[S_PDAMP] * abs(x) * w
            if has[S_STOP]:
                depth = abs(x) - n[S_STOP]
                if depth > 0.0:
                    outward = w if x > 0.0 else -w
                    push = n[S_STOP + 1] * depth + (n[S_STOP + 2] * outward if outward > 0.0 else 0.0)
                    force -= push if x > 0.0 else -push
            if has[S_HYST]:
                # exponent 2: the restoring part follows |z|
                wind += h * (w - 0.5 * abs(w) * abs(wind) * wind - 0.5 * w * wind * wind) / n[S_HYST + 1]
                force -= n[S_HYST] * wind
            if has[S_VISCO]:
                creep += h * (x - creep) / n[S_VISCO + 1]
                force -= n[S_VISCO] * (x - creep)
            if has[S_MODE]:
                mode_force = n[S_MODE] * (x - mode) + n[S_MODE + 1] * (w - mode_speed)
                mode_speed += h * mode_force / n[S_MODE + 2]
                mode += h * mode_speed
                force -= mode_force
            if has[S_ELASTIC]:
                share = n[S_ELASTIC + 2]
                coupling = n[S_ELASTIC] * twist + n[S_ELASTIC + 1] * twist_speed
                twist_speed += h * ((drive - coupling) / share - (force - damping * w + coupling) / (1.0 - share))
                twist += h * twist_speed
                pulled = (force - damping * w + coupling) / (1.0 - share)
            else:
                pulled = force - damping * w + drive
            # friction
            stick = n[S_COULOMB] + n[S_LOAD] * abs(drive - spring) / 2.0 + n[S_GROW] * max(now, 0.0)
            if has[S_STRIBECK]:
                stick += n[S_STRIBECK] + n[S_STRIBECK + 1] * np.exp(-((w / n[S_STRIBECK + 2]) ** 2))
            speed = v + h * pulled
            if stick > 0.0:
                if speed > h * stick:
                    speed -= h * stick
                elif speed < -h * stick:
                    speed += h * stick
                else:
                    speed = 0.0
            q = x + (h * speed if parts == 1 else 0.5 * h * speed)
            gained, v = speed - v, speed
            slow = slow + (v - 0.5 * gained - slow) * (1.0 - np.exp(-h / n[S_VLAG])) if has[S_VLAG] else v
            fine_q[j + 1], fine_v[j + 1] = q, slow
    return issued, observed
