"""Trial: a machine drawn by lot, its recordings, and the label that says what is wrong with it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from trueup.model.tree import DAMPING, FRICTION, Tree
from trueup.simulate.excitation import SHAPES, planned
from trueup.simulate.machine import BEYOND, SLOTS, Feedback, Machine, Run, run
from trueup.simulate.robot import OF_DRIVE, Follow, RobotMachine, RobotPlan, rotor
from trueup.simulate.robot import run as run_robot

Array = NDArray[np.float64]
AnyMachine = TypeVar("AnyMachine", Machine, RobotMachine)
CATALOGUE = tuple(name for name in SLOTS if name not in BEYOND)
ROUNDS = 18  # of bisection for a magnitude
CLOSE = 0.1  # of what is wanted: close enough for a lot


@dataclass(frozen=True)
class Plan:
    """What one recording is commanded, or the reference it is to follow, `(samples,)`, and the position and velocity it starts from."""

    role: str
    series: Array
    start: tuple[float, float]


@dataclass(frozen=True)
class Bench:
    """How trials of one plant are made: its numbers, rates, noise and excitation.

    With `recorded` plans every machine is given those; without, each trial draws its own. A second before each log is not logged.
    """

    kind: str
    k: float
    c: float
    b: float
    limit: float
    timestep_s: float
    parts: int
    duration_s: float
    noise: float  # of a channel's standard deviation
    feedback: Feedback | None
    reach: float  # what a planned value of 1 stands for: a command, or a reference position
    recorded: Sequence[Plan] = ()
    bounds: tuple[float, float] | None = None  # of the command, where they are not +-limit
    sigma: tuple[float, float] | None = None  # of position and velocity, instead of `noise`

    @property
    def warm_up(self) -> int:
        """Samples before the log begins."""
        return min([round(1.0 / self.timestep_s), *(len(p.series) - 1 for p in self.recorded)])

    def led_in(self, series: Array) -> Array:
        """A series with its warm-up: a recorded one is led in by its own beginning backwards, so that its machine is under way."""
        return np.concatenate([series[self.warm_up : 0 : -1], series]) if self.recorded else series


@dataclass(frozen=True)
class Trial:
    """What was recorded, by role, and what is wrong: a machine with its effects, whether parameters moved, the gap that the least makes.

    `sigma` is the noise of positions and velocities `(2 x joints,)`.
    """

    machine: Machine | RobotMachine
    shifted: bool
    gap: float
    sigma: Array
    runs: Sequence[tuple[str, Run]]

    def of(self, role: str) -> list[Run]:
        """The recordings of one role."""
        return [run for of, run in self.runs if of == role]


def draw_bench(tier: str, rng: np.random.Generator) -> Bench:
    """A plant of one of four tiers: A0 the chapter's discrete oscillator, A1 oscillator, B1 pendulum, B2 an inertia in a loop."""
    if tier == "A0":
        return Bench("oscillator", 1.0, 0.4, 1.0, 1.0, 0.05, 1, 8.0, 0.0, None, 1.0)
    if tier == "A1":
        k, c, b = rng.uniform(0.8, 3.2), rng.uniform(0.3, 0.8), rng.uniform(0.8, 1.3)
        return Bench("oscillator", k, c, b, 1.0, 0.02, 20, 8.0, rng.uniform(0.002, 0.01), None, 1.0)
    if tier == "B1":
        k, c, b = rng.uniform(6.0, 18.0), rng.uniform(0.7, 2.0), rng.uniform(0.9, 1.2)
        limit = round(k * rng.uniform(0.25, 0.6), 1)
        return Bench("pendulum", k, c, b, limit, 0.01, 20, 8.0, rng.uniform(0.002, 0.008), None, limit)
    c, b = rng.uniform(0.6, 2.0), rng.uniform(4.0, 12.0)
    return Bench(
        "inertia", 0.0, c, b, 2.0, 0.005, 10, 8.0, rng.uniform(0.002, 0.006), Feedback(rng.uniform(3.0, 8.0), rng.uniform(0.3, 0.8)), 1.0
    )


def draw(
    bench: Bench,
    names: Sequence[str],
    shifted: bool,
    rng: np.random.Generator,
    gaps: tuple[float, float] = (0.06, 0.5),
    spread: tuple[float, float] = (0.75, 1.3),
) -> Trial:
    """A machine of a bench with the named imperfections, each as large as a gap drawn within `gaps`, recorded by the bench's plans.

    The gap is the change of position that an imperfection causes, relative to the motion; of the velocity where it changes that alone.
    Parameters that are shifted move by factors within `spread`.
    """
    moved = rng.uniform(*spread, 3) if shifted else np.ones(3)
    machine = Machine(bench.kind, bench.k * moved[0], bench.c * moved[1], bench.b * moved[2], bench.limit, bounds=bench.bounds)
    plan = bench.recorded or [Plan("", _plan(bench, shape, rng), (0.0, 0.0)) for shape in SHAPES]
    size = _sizes(bench, machine, plan)
    gaps_made = []
    for name in names:
        wanted = float(np.exp(rng.uniform(*np.log(gaps))))
        shape = _shape(name, size, rng, hardens=bench.kind == "inertia")
        machine, reached = _as_large_as(machine, name, shape, wanted, lambda m: _seen(bench, m, plan), int(name == "velocity_lag"))
        gaps_made.append(reached)
    sigma = bench.sigma or (bench.noise * size["position"], bench.noise * 1.5 * size["velocity"])
    if "sensor_quantization" in names:
        sigma = (sigma[0] * 0.3, sigma[1] * 0.3)
    runs = [
        (p.role, run(machine, bench.led_in(p.series), bench.timestep_s, bench.parts, sigma, rng, p.start, bench.warm_up, bench.feedback))
        for p in _plans(bench, size, rng)
    ]
    return Trial(machine, shifted, min(gaps_made, default=0.0), np.array(sigma), runs)


def _plans(bench: Bench, size: Mapping[str, float], rng: np.random.Generator) -> Iterator[Plan]:
    """What is recorded: drawn series from rest about the middle, or the recorded ones, and as a test those of validation backwards."""
    if bench.recorded:
        yield from bench.recorded
        for p in bench.recorded:
            if p.role == "validation":
                yield Plan("test", np.ascontiguousarray(p.series[::-1]), (float(p.series[-1]), 0.0) if bench.feedback else p.start)
        return
    for i, role in zip((0, 1, 2, 3, 0, 2, 0, 1, 2, 3), ["adaptation"] * 4 + ["validation"] * 2 + ["test"] * 4, strict=True):
        series = _plan(bench, SHAPES[i], rng)
        yield Plan(role, series, (0.3 * rng.normal() * size["position"], 0.3 * rng.normal() * size["velocity"]))


def _plan(bench: Bench, shape: str, rng: np.random.Generator) -> Array:
    return bench.reach * planned(shape, round(bench.duration_s / bench.timestep_s) + 1 + bench.warm_up, bench.timestep_s, rng)


def _record(bench: Bench, machine: Machine, plan: Sequence[Plan]) -> list[Run]:
    quiet = np.random.default_rng(0)
    return [
        run(machine, bench.led_in(p.series), bench.timestep_s, bench.parts, (0.0, 0.0), quiet, p.start, bench.warm_up, bench.feedback)
        for p in plan
    ]


def _seen(bench: Bench, machine: Machine, plan: Sequence[Plan]) -> Array:
    return np.concatenate([r.observed for r in _record(bench, machine, plan)])


def _sizes(bench: Bench, machine: Machine, plan: Sequence[Plan]) -> dict[str, float]:
    runs = _record(bench, machine, plan)
    y = np.concatenate([r.observed for r in runs])
    u = np.concatenate([r.issued for r in runs])
    return {
        "position": float(y[:, 0].std()), "velocity": float(y[:, 1].std()), "travel": float(np.abs(y[:, 0]).max()),
        "acceleration": float(machine.b * u.std()), "command": float(np.abs(u).max()), "time": float(y[:, 0].std() / y[:, 1].std()),
    }  # fmt: skip


def _shape(name: str, s: Mapping[str, float], rng: np.random.Generator, *, hardens: bool) -> dict[str, tuple[float, float, bool]]:
    """Of each number: its value at magnitude 0 and its growth with magnitude, or (value, 0) where it does not grow.

    `s` are the sizes of the joint's motion and forces; a cubic spring `hardens` where nothing else holds the joint.
    """
    a, q, v, u, t = s["acceleration"], s["position"], s["velocity"], s["command"], s["time"]
    sign = float(rng.choice([-1.0, 1.0]))
    odd = float(name == "quadratic_gain" and rng.random() < 0.5)  # noqa: PLR2004

    def grows(by: float, at: float = 0.0) -> tuple[float, float, bool]:
        return (at, by, False)

    def fixed(value: float) -> tuple[float, float, bool]:
        return (value, 0.0, False)

    def shrinks(by: float) -> tuple[float, float, bool]:
        return (by, 0.0, True)

    shapes: dict[str, dict[str, tuple[float, float, bool]]] = {
        "coulomb_friction": {"level": grows(a)},
        "stribeck_friction": {
            "level": grows(0.4 * a),
            "extra": grows(a * rng.uniform(0.4, 1.0)),
            "speed": fixed(v * rng.uniform(0.1, 0.4)),
        },
        "quadratic_drag": {"coefficient": grows(a / v**2)},
        "cubic_stiffness": {"coefficient": grows(a / q**3 * (1.0 if hardens else sign) * 0.3)},
        "constant_force": {"level": grows(a * sign)},
        "hysteresis": {"level": grows(a), "distance": fixed(q * rng.uniform(0.15, 0.6))},
        "hard_stop": {"limit": shrinks(s["travel"]), "stiffness": fixed(400.0 * a / q), "damping": fixed(5.0 * a / v)},
        "cogging": {"amplitude": grows(a), "pitch": fixed(q * rng.uniform(0.3, 1.2)), "phase": fixed(rng.uniform(0, 6.28))},
        "elastic_transmission": {"stiffness": shrinks(40.0 / t**2), "damping": fixed(0.15 / t), "share": fixed(rng.uniform(0.15, 0.5))},
        "load_dependent_friction": {"coefficient": grows(1.0)},
        "asymmetric_viscous_friction": {"difference": grows(a / v * sign)},
        "deadband": {"width": grows(u)},
        "backlash": {"gap": grows(u)},
        "actuator_lag": {"time_constant": grows(t)},
        "actuator_delay": {"delay": grows(t)},
        "saturation": {"limit": shrinks(u)},
        "rate_limit": {"rate": shrinks(20.0 * u / t)},
        "thermal_derating": {"loss": grows(1.0), "time_constant": fixed(rng.uniform(1.5, 6.0))},
        "gain_asymmetry": {"asymmetry": grows(sign)},
        "command_quantization": {"step": grows(u)},
        "quadratic_gain": {"odd": grows(0.7 * sign * odd), "even": grows(0.7 * sign * (1.0 - odd))},
        "sensor_delay": {"delay": grows(t)},
        "sensor_bias": {"bias": grows(q * sign)},
        "sensor_scale": {"error": grows(sign)},
        "sensor_quantization": {"step": grows(q), "velocity_step": fixed(0.0)},
        "sensor_drift": {"rate": grows(q / 8.0 * sign)},
        "clock_skew": {"skew": grows(sign)},
        "dropped_frames": {"fraction": fixed(rng.uniform(0.05, 0.3))},
        "velocity_lag": {"time_constant": grows(t)},
        "k_modulated": {"depth": grows(1.0), "rate": fixed(rng.uniform(0.7, 2.5))},
        "van_der_pol": {"strength": grows(a / v), "width": fixed(q)},
        "position_damping": {"coefficient": grows(a / v / q)},
        "torque_speed": {"loss": grows(0.3 / v)},
        "hidden_mode": {"stiffness": grows(a / q), "damping": fixed(0.02 * a / v), "share": fixed(rng.uniform(0.1, 0.4))},
        "viscoelastic": {"stiffness": grows(a / q), "time_constant": fixed(t * rng.uniform(0.5, 2.0))},
        "asymmetric_stiffness": {"change": grows(sign)},
        "growing_friction": {"rate": grows(a / 8.0)},
    }
    return shapes[name]


def _as_large_as(
    machine: AnyMachine,
    name: str,
    shape: Mapping[str, tuple[float, float, bool]],
    wanted: float,
    observe: Callable[[AnyMachine], Array],
    column: int,
    joint: int = 0,
) -> tuple[AnyMachine, float]:
    """The machine with one imperfection more, its magnitude bisected until it moves an observed column by `wanted` of its motion."""
    without = observe(machine)[:, column]
    low, high, best, reached = 0.0, 1.0, machine, 0.0  # the largest that is not too large
    for _ in range(ROUNDS):
        size = 0.5 * (low + high)
        tried = machine.having(name, {key: at * (1.0 - size) if falls else at + by * size for key, (at, by, falls) in shape.items()}, joint)
        with_it = observe(tried)[:, column]
        with np.errstate(over="ignore", invalid="ignore"):  # a machine that runs away is too much
            gap = float(np.sqrt(np.mean((with_it - without) ** 2)) / without.std())
        if not np.isfinite(gap) or gap > (1.0 + CLOSE) * wanted:
            high = size
        else:
            low, best, reached = size, tried, gap
            if gap > (1.0 - CLOSE) * wanted:
                break
    if best is machine:  # none was small enough: the smallest
        best, reached = tried, gap
    return best, reached


@dataclass(frozen=True)
class RobotBench:
    """How trials of one robot are made: its numbers, rates and noise, and what was recorded. A second before each log is not logged.

    `drive` `(joints,)` is the largest declared command, `asked` what each joint's drive was asked for at most: a command, or a servo's
    error; `force` that of its motion; `sigma` `(2 x joints,)` the noise.
    """

    tree: Tree
    low: Array
    high: Array
    drive: Array
    asked: Array
    force: Array
    timestep_s: float
    parts: int
    sigma: Array
    feedback: Follow | None
    recorded: Sequence[RobotPlan]

    @property
    def warm_up(self) -> int:
        """Samples before the log begins."""
        return min([round(1.0 / self.timestep_s), *(len(p.commands) - 1 for p in self.recorded)])

    @property
    def machine(self) -> RobotMachine:
        """The robot without anything wrong."""
        return RobotMachine(self.tree, self.low, self.high, self.drive)

    def record(self, machine: RobotMachine, plan: RobotPlan, sigma: Array, rng: np.random.Generator) -> Run:
        """What a robot does on a plan."""
        return run_robot(machine, plan, self.timestep_s, self.parts, sigma, rng, self.warm_up, self.feedback)


def draw_robot(
    bench: RobotBench,
    terms: Sequence[tuple[str, int]],
    shifted: bool,
    rng: np.random.Generator,
    gaps: tuple[float, float],
    spread: tuple[float, float],
) -> Trial:
    """A robot of a bench with imperfections, each an effect at a joint and as large as a gap drawn within `gaps`, recorded by the bench's
    plans, and by those of validation backwards.

    The gap is the change of the joint's position, or velocity where it changes that alone, on the plan in which the joint moves most.
    Masses with their moments, dampings and friction losses that are shifted move by factors within `spread`, each link's and joint's its
    own.
    """
    machine, joints = bench.machine, len(bench.tree.joints)
    if shifted:
        machine = replace(machine, tree=_moved(bench.tree, rng, spread))
    sigma, gaps_made = bench.sigma, []

    def observe(tried: RobotMachine, joint: int) -> Array:
        most = max(bench.recorded, key=lambda p: float(p.reached[:, joint].std()))
        return bench.record(tried, most, np.zeros(2 * joints), np.random.default_rng(0)).observed

    for name, joint in terms:
        wanted = float(np.exp(rng.uniform(*np.log(gaps))))
        size = _robot_sizes(bench, name, joint)
        shape = _shape(name, size, rng, hardens=True)
        if name == "elastic_transmission":  # the rotor is part of the armature
            largest = rotor(machine.tree, joint)
            shape |= {"share": (largest, 0.0, False), "stiffness": (40.0 * largest / size["time"] ** 2, 0.0, True)}
            shape |= {"damping": (0.15 * largest / size["time"], 0.0, False)}
        column = joints + joint if name == "velocity_lag" else joint
        machine, reached = _as_large_as(machine, name, shape, wanted, partial(observe, joint=joint), column, joint)
        gaps_made.append(reached)
        if name == "sensor_quantization":
            sigma = np.where(np.arange(2 * joints) % joints == joint, 0.3 * sigma, sigma)
    plans = [*bench.recorded, *(p.backwards("test") for p in bench.recorded if p.role == "validation")]
    gap = min(gaps_made, default=0.0)
    return Trial(machine, shifted, gap, sigma, [(p.role, bench.record(machine, p, sigma, rng)) for p in plans])


def _moved(tree: Tree, rng: np.random.Generator, spread: tuple[float, float]) -> Tree:
    """Other masses, dampings and friction losses."""
    joints = len(tree.joints)
    links, at_joint = tree.links * rng.uniform(*spread, (joints, 1)), tree.at_joint
    at_joint[:, [DAMPING, FRICTION]] *= rng.uniform(*spread, (joints, 2))
    return replace(tree, parameters=tuple(float(x) for x in [*links.ravel(), *at_joint.ravel()]))


def _robot_sizes(bench: RobotBench, name: str, joint: int) -> dict[str, float]:
    """Sizes of one joint's motion and forces, as recorded, and of the command that an effect acts on: a servo's goal, or its error."""
    joints = len(bench.tree.joints)
    reached = np.concatenate([p.reached for p in bench.recorded])
    goal = max(float(np.abs(p.commands[:, joint]).max()) for p in bench.recorded)
    q, v = float(reached[:, joint].std()), float(reached[:, joints + joint].std())
    return {
        "position": q,
        "velocity": v,
        "travel": float(np.abs(reached[:, joint]).max()),
        "acceleration": float(bench.force[joint]),
        "command": float(bench.asked[joint]) if name in OF_DRIVE else goal,
        "time": q / v,
    }
