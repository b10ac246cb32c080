"""Machine: one joint with known imperfections, integrated on a step far finer than its log.

It is written apart from the models that are fitted to its logs, and on purpose with other laws:
velocity-verlet steps, friction after Karnopp with an exponential Stribeck curve, Bouc-Wen
hysteresis of exponent 2, a one-way damped stop. Resistance to motion is evaluated at the middle of
a fine step, extrapolated from the last one. Sources: D. Karnopp, ASME Journal of Dynamic Systems
107 (1985); R. Bouc (1967), Y.-K. Wen (1976).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numba import njit
from numpy.typing import NDArray

from trueup.simulate.noise import WHITE, NoiseModel

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
(S_COULOMB, S_STRIBECK, S_DRAG, S_CUBIC, S_FORCE, S_HYST, S_STOP, S_COG, S_ELASTIC, S_LOAD,
    S_VASYM, S_DEAD, S_PLAY, S_LAG, S_DELAY,
 S_SAT, S_RATE, S_HEAT, S_ASYM, S_CQUANT, S_QGAIN, S_SDELAY, S_BIAS, S_SCALE, S_SQUANT, S_DRIFT,
 S_VLAG, S_SKEW, S_DROP, S_KMOD, S_VDP,
 S_PDAMP, S_SPEED, S_MODE, S_VISCO, S_ASTIFF,
 S_GROW) = (int(FIRST[name]) for name in SLOTS)  # fmt: skip


@dataclass(frozen=True)
class Machine:
    """A joint: its kind, its true k, c, b (per unit mass), its command limit, and its
    imperfections. `bounds` are the command's limits where they are not +-limit."""

    kind: str
    k: float
    c: float
    b: float
    limit: float
    imperfections: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    bounds: tuple[float, float] | None = None

    def having(self, name: str, values: Mapping[str, float], _joint: int = 0) -> Machine:
        """The machine with one more imperfection."""
        return replace(self, imperfections={**self.imperfections, name: values})

    def by_joint(self) -> dict[tuple[str, int], Mapping[str, float]]:
        """The imperfections' numbers, by effect and joint."""
        return {(name, 0): values for name, values in self.imperfections.items()}

    def parameters(self) -> dict[str, float]:
        """The true numbers of the family by name."""
        return {"k": self.k, "c": self.c, "b": self.b}

    def vector(self) -> tuple[Array, NDArray[np.bool_]]:
        """The imperfections' numbers, and which of them are present, `(SIZE,)` each."""
        numbers, present = np.zeros(SIZE), np.zeros(SIZE, np.bool_)
        for name, values in self.imperfections.items():
            for offset, key in enumerate(SLOTS[name]):
                numbers[FIRST[name] + offset] = values[key]
                present[FIRST[name] + offset] = True
        return numbers, present


@dataclass(frozen=True)
class Run:
    """A log: sample times [s] `(n,)`, issued commands `(n,)`, observed position and velocity `(n,
    2)`; of a robot `(n, joints)` and `(n, 2 x joints)`.
    """

    t_s: Array
    issued: Array
    observed: Array


@dataclass(frozen=True)
class Feedback:
    """u = kp (reference - position) - kd velocity, on observed values."""

    kp: float
    kd: float


def run(
    machine: Machine, planned: Array, timestep_s: float, parts: int, sigma: tuple[float, float],
    rng: np.random.Generator,
    start: tuple[float, float] = (0.0, 0.0), warm_up: int = 0, feedback: Feedback | None = None,
    law: NoiseModel = WHITE, *, ramped: bool = False,
) -> Run:  # fmt: skip
    """Run a machine on planned commands, or on references with feedback, `(warm_up + n,)`. The log
    begins after the warm-up. Planned commands that are `ramped` are lines between their samples.

    `parts` fine steps make a sample; with one, the step is the plain semi-implicit one of a
    discrete-time plant.
    """
    numbers, present = machine.vector()
    total = len(planned)
    noise = law.drawn(rng, total, 2) * np.array(sigma)
    lost = rng.random(total)
    low, high = machine.bounds or (-machine.limit, machine.limit)
    gains = (feedback.kp, feedback.kd) if feedback else (0.0, 0.0)
    issued, observed = _run(
        KINDS[machine.kind], machine.k, machine.c, machine.b, low, high, machine.limit, numbers,
        present, np.ascontiguousarray(planned),
        timestep_s, parts,
        noise, lost, start[0], start[1], warm_up, feedback is not None, gains[0], gains[1],
        ramped and not feedback,
    )  # fmt: skip
    kept = slice(warm_up, total)
    return Run(
        np.asarray(np.arange(total - warm_up) * timestep_s, np.float64),
        issued[kept].copy(),
        observed[kept].copy(),
    )


# What a joint remembers between fine steps.
(
    M_PLAY,
    M_LAG,
    M_RATE,
    M_HEAT,
    M_WIND,
    M_CREEP,
    M_MODE,
    M_MODE_SPEED,
    M_TWIST,
    M_TWIST_SPEED,
    M_SLOW,
) = range(11)
MEMORY = 11


@njit(cache=True)
def sensed(n, fine_q, fine_v, j, h, now):  # type: ignore[no-untyped-def]
    """Position and velocity as a joint's sensors show them at fine step `j`, before noise."""
    wait = int(n[S_SDELAY] / h)
    rest, past = n[S_SDELAY] / h - wait, max(0, j - wait)
    before = max(0, past - 1)
    q = (1.0 - rest) * fine_q[past] + rest * fine_q[before]
    v = (1.0 - rest) * fine_v[past] + rest * fine_v[before]
    return q * (1.0 + n[S_SCALE]) + n[S_BIAS] + n[S_DRIFT] * max(now, 0.0), v


@njit(cache=True)
def stored(n, has, q, v, luck, last_q, last_v, first):  # type: ignore[no-untyped-def]
    """Position and velocity as the log stores them: quantized, or the last ones where a frame is
    dropped."""
    if has[S_SQUANT]:
        q = n[S_SQUANT] * np.floor(q / n[S_SQUANT] + 0.5)
        if n[S_SQUANT + 1] > 0.0:
            v = n[S_SQUANT + 1] * np.floor(v / n[S_SQUANT + 1] + 0.5)
    if has[S_DROP] and not first and luck < n[S_DROP]:
        q, v = last_q, last_v
    return q, v


@njit(cache=True)
def arriving(n, fine_u, j, h):  # type: ignore[no-untyped-def]
    """The command that arrives at fine step `j`."""
    wait = int(n[S_DELAY] / h)
    rest = n[S_DELAY] / h - wait
    return (1.0 - rest) * fine_u[max(0, j - wait)] + rest * fine_u[max(0, j - wait - 1)]


@njit(cache=True)
def driven(n, has, m, u, h, fine, limit):  # type: ignore[no-untyped-def]
    """The command after the drive's imperfections. `fine` says that a step is a part of a
    sample."""
    if has[S_CQUANT]:
        u = n[S_CQUANT] * np.floor(u / n[S_CQUANT] + 0.5)
    if has[S_SAT]:
        u = min(max(u, -n[S_SAT]), n[S_SAT])
    if has[S_RATE]:
        change = u - m[M_RATE]
        most = n[S_RATE] * h
        later = u if abs(change) <= most else m[M_RATE] + (most if change > 0.0 else -most)
        u = 0.5 * (m[M_RATE] + later) if fine else later
        m[M_RATE] = later
    if has[S_DEAD]:
        u = 0.0 if abs(u) <= n[S_DEAD] else (u - n[S_DEAD] if u > 0.0 else u + n[S_DEAD])
    if has[S_PLAY]:
        half = n[S_PLAY] / 2.0
        if u - m[M_PLAY] > half:
            m[M_PLAY] = u - half
        elif m[M_PLAY] - u > half:
            m[M_PLAY] = u + half
        u = m[M_PLAY]
    if has[S_LAG]:
        later = m[M_LAG] + (u - m[M_LAG]) * (1.0 - np.exp(-h / n[S_LAG]))
        u = 0.5 * (m[M_LAG] + later) if fine else later
        m[M_LAG] = later
    if has[S_ASYM]:
        u = u * (1.0 + n[S_ASYM]) if u > 0.0 else u * (1.0 - n[S_ASYM])
    if has[S_HEAT]:
        m[M_HEAT] += h * ((u / limit) ** 2 - m[M_HEAT]) / n[S_HEAT + 1]
        u = u * max(0.05, 1.0 - n[S_HEAT] * m[M_HEAT])
    if has[S_QGAIN]:
        u = u * (1.0 + (n[S_QGAIN] * abs(u) + n[S_QGAIN + 1] * u) / limit)
    return u


@njit(cache=True)
def pulling(n, has, m, force, x, w, h):  # type: ignore[no-untyped-def]
    """A force, with those added that act on a joint at position `x` and velocity `w`, without dry
    friction."""
    force += n[S_FORCE] - n[S_DRAG] * w * abs(w) - n[S_CUBIC] * x**3
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
        m[M_WIND] += (
            h
            * (w - 0.5 * abs(w) * abs(m[M_WIND]) * m[M_WIND] - 0.5 * w * m[M_WIND] * m[M_WIND])
            / n[S_HYST + 1]
        )
        force -= n[S_HYST] * m[M_WIND]
    if has[S_VISCO]:
        m[M_CREEP] += h * (x - m[M_CREEP]) / n[S_VISCO + 1]
        force -= n[S_VISCO] * (x - m[M_CREEP])
    if has[S_MODE]:
        mode_force = n[S_MODE] * (x - m[M_MODE]) + n[S_MODE + 1] * (w - m[M_MODE_SPEED])
        m[M_MODE_SPEED] += h * mode_force / n[S_MODE + 2]
        m[M_MODE] += h * m[M_MODE_SPEED]
        force -= mode_force
    return force


@njit(cache=True)
def sticking(n, has, w, load, now):  # type: ignore[no-untyped-def]
    """The force up to which dry friction holds a joint that moves at `w`; `load` is the force in
    its transmission."""
    stick = n[S_COULOMB] + n[S_LOAD] * abs(load) / 2.0 + n[S_GROW] * max(now, 0.0)
    if has[S_STRIBECK]:
        stick += n[S_STRIBECK] + n[S_STRIBECK + 1] * np.exp(-((w / n[S_STRIBECK + 2]) ** 2))
    return stick


@njit(cache=True)
def observed_velocity(n, has, m, v, gained, h):  # type: ignore[no-untyped-def]
    """The observed velocity: a slow estimate lags behind the true one."""
    m[M_SLOW] = (
        m[M_SLOW] + (v - 0.5 * gained - m[M_SLOW]) * (1.0 - np.exp(-h / n[S_VLAG]))
        if has[S_VLAG]
        else v
    )
    return m[M_SLOW]


@njit(cache=True)
def _run(  # type: ignore[no-untyped-def]
    kind, k, c, b, low, high, limit, n, has, planned, dt, parts, noise, lost, q, v, warm_up,
    closed, kp, kd, ramped,
):  # fmt: skip
    total, fine = len(planned), parts > 1
    h = dt * (1.0 + n[S_SKEW]) / parts
    issued, observed = np.zeros(total), np.zeros((total, 2))
    fine_q, fine_v = np.zeros(total * parts + 1), np.zeros(total * parts + 1)
    fine_u, m, gained = np.zeros(total * parts + 1), np.zeros(MEMORY), 0.0
    fine_q[0], fine_v[0], m[M_SLOW] = q, v, v
    for i in range(total):
        now = (i - warm_up) * dt
        seen_q, seen_v = sensed(n, fine_q, fine_v, i * parts, h, now)
        last = observed[i - 1] if i > 0 else observed[0]
        seen_q, seen_v = stored(
            n, has, seen_q + noise[i, 0], seen_v + noise[i, 1], lost[i], last[0], last[1], i == 0
        )
        observed[i, 0], observed[i, 1] = seen_q, seen_v
        u = kp * (planned[i] - seen_q) - kd * seen_v if closed else planned[i]
        issued[i] = min(max(u, low), high)
        rise = 0.0
        if ramped and i + 1 < total:
            rise = min(max(planned[i + 1], low), high) - issued[i]
        for part in range(parts):
            j = i * parts + part
            fine_u[j] = issued[i] + rise * (part + 0.5) / parts  # its mean over the step
            u = driven(n, has, m, arriving(n, fine_u, j, h), h, fine, limit)
            # forces on the joint at rest of its friction
            x = q + 0.5 * h * v if fine else q
            w = v + 0.5 * gained if fine else v
            stiffness = k
            if has[S_KMOD]:
                stiffness = k * (1.0 + n[S_KMOD] * np.sin(n[S_KMOD + 1] * now))
            if has[S_ASTIFF]:
                stiffness = k * (1.0 + n[S_ASTIFF]) if x > 0.0 else k * (1.0 - n[S_ASTIFF])
            spring = 0.0 if kind == 0 else (-stiffness * x if kind == 1 else -stiffness * np.sin(x))
            drive = b * u * (1.0 - n[S_SPEED] * abs(w))
            damping = c + n[S_VASYM] if w > 0.0 else c - n[S_VASYM]
            force = pulling(n, has, m, spring, x, w, h)
            if has[S_ELASTIC]:
                share = n[S_ELASTIC + 2]
                coupling = n[S_ELASTIC] * m[M_TWIST] + n[S_ELASTIC + 1] * m[M_TWIST_SPEED]
                m[M_TWIST_SPEED] += h * (
                    (drive - coupling) / share - (force - damping * w + coupling) / (1.0 - share)
                )
                m[M_TWIST] += h * m[M_TWIST_SPEED]
                pulled = (force - damping * w + coupling) / (1.0 - share)
            else:
                pulled = force - damping * w + drive
            stick = sticking(n, has, w, drive - spring, now)
            speed = v + h * pulled
            if stick > 0.0:
                if speed > h * stick:
                    speed -= h * stick
                elif speed < -h * stick:
                    speed += h * stick
                else:
                    speed = 0.0
            q = x + (0.5 * h * speed if fine else h * speed)
            gained, v = speed - v, speed
            fine_q[j + 1], fine_v[j + 1] = q, observed_velocity(n, has, m, v, gained, h)
    return issued, observed
