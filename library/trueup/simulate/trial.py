"""Simulated trials of one joint: a randomly drawn machine, its imperfections and its recordings.

`Bench` is what a simulated trial is made with, whatever kind of plant it is of.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

from trueup.simulate.excitation import SHAPES, planned
from trueup.simulate.machine import BEYOND, SLOTS, Feedback, Machine, Run, run
from trueup.simulate.magnitude import as_large_as, shape_of
from trueup.simulate.noise import WHITE, NoiseModel
from trueup.simulate.robot import Follow, RobotMachine

Array = NDArray[np.float64]
CATALOGUE = tuple(name for name in SLOTS if name not in BEYOND)


@dataclass(frozen=True)
class Plan:
    """The plan of one recording: commands, or a reference to follow, `(samples,)`, and the position
    and velocity that it starts from."""

    role: str
    series: Array
    start: tuple[float, float]


class Bench(Protocol):
    """How trials of one plant are made."""

    robot: ClassVar[bool]

    @property
    def timestep_s(self) -> float:
        """The sampling period [s]."""

    @property
    def parts(self) -> int:
        """Fine steps in a sampling period."""

    @property
    def sigma(self) -> Sequence[float] | Array | None:
        """Standard deviations of the noise, positions before velocities, or None where they are
        relative to each machine's motion."""

    @property
    def feedback(self) -> Feedback | Follow | None:
        """The controller that follows the plan; None where plans are commands."""

    def relative_noise(self) -> float:
        """The noise over the standard deviation of the motion, of the noisiest channel."""

    def draw(
        self,
        imperfections: Sequence[tuple[str, int]],
        shifted: bool,
        rng: np.random.Generator,
        gaps: tuple[float, float],
        spread: tuple[float, float],
    ) -> SimulatedTrial:
        """A machine with `imperfections`, each an effect at a joint, and its recordings.

        Each imperfection is as large as a gap drawn within `gaps`: the change of the joint's
        position, relative to its motion. If `shifted`, parameters move by factors within `spread`.
        """


@dataclass(frozen=True)
class JointBench:
    """A `Bench` of one joint: its numbers, rates, noise and excitation.

    With `recorded` plans every machine is given those; without, each trial draws its own. A second
    before each log is not logged.
    """

    robot: ClassVar[bool] = False

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
    law: NoiseModel = WHITE  # of that noise
    ramped: bool = False  # whether commands are lines between their samples
    unshifted: tuple[float, float, float] | None = None  # k, c, b of machines that are not shifted

    @property
    def warm_up(self) -> int:
        """Samples before the log begins."""
        return min([round(1.0 / self.timestep_s), *(len(p.series) - 1 for p in self.recorded)])

    def led_in(self, series: Array) -> Array:
        """A series with its warm-up. A recorded series is led in by its own beginning backwards, so
        that its machine is under way."""
        return np.concatenate([series[self.warm_up : 0 : -1], series]) if self.recorded else series

    def relative_noise(self) -> float:
        """The noise over the standard deviation of the motion."""
        return self.noise

    def draw(
        self,
        imperfections: Sequence[tuple[str, int]],
        shifted: bool,
        rng: np.random.Generator,
        gaps: tuple[float, float],
        spread: tuple[float, float],
    ) -> SimulatedTrial:
        """A machine with these imperfections, recorded on this bench."""
        return draw(self, [name for name, _ in imperfections], shifted, rng, gaps, spread)


@dataclass(frozen=True)
class SimulatedTrial:
    """The recordings of one machine, by role, and what is wrong with it: `shifted` says whether its
    parameters moved, `gap` is the smallest gap that an imperfection makes, `sigma` the noise of
    positions and velocities `(2 x joints,)`."""

    machine: Machine | RobotMachine
    shifted: bool
    gap: float
    sigma: Array
    runs: Sequence[tuple[str, Run]]

    def of(self, role: str) -> list[Run]:
        """The recordings of one role."""
        return [run for of, run in self.runs if of == role]


def draw_bench(tier: str, rng: np.random.Generator) -> JointBench:
    """A plant of one of four tiers: A0 the chapter's discrete oscillator, A1 oscillator, B1
    pendulum, B2 an inertia in a loop."""
    if tier == "A0":
        return JointBench("oscillator", 1.0, 0.4, 1.0, 1.0, 0.05, 1, 8.0, 0.0, None, 1.0)
    if tier == "A1":
        k, c, b = rng.uniform(0.8, 3.2), rng.uniform(0.3, 0.8), rng.uniform(0.8, 1.3)
        return JointBench(
            "oscillator", k, c, b, 1.0, 0.02, 20, 8.0, rng.uniform(0.002, 0.01), None, 1.0
        )
    if tier == "B1":
        k, c, b = rng.uniform(6.0, 18.0), rng.uniform(0.7, 2.0), rng.uniform(0.9, 1.2)
        limit = round(k * rng.uniform(0.25, 0.6), 1)
        return JointBench(
            "pendulum", k, c, b, limit, 0.01, 20, 8.0, rng.uniform(0.002, 0.008), None, limit
        )
    c, b = rng.uniform(0.6, 2.0), rng.uniform(4.0, 12.0)
    return JointBench(
        "inertia",
        0.0,
        c,
        b,
        2.0,
        0.005,
        10,
        8.0,
        rng.uniform(0.002, 0.006),
        Feedback(rng.uniform(3.0, 8.0), rng.uniform(0.3, 0.8)),
        1.0,
    )


def draw(
    bench: JointBench,
    names: Sequence[str],
    shifted: bool,
    rng: np.random.Generator,
    gaps: tuple[float, float] = (0.06, 0.5),
    spread: tuple[float, float] = (0.75, 1.3),
) -> SimulatedTrial:
    """A machine of a bench with the named imperfections, each as large as a gap drawn within
    `gaps`, recorded by the bench's plans.

    The gap is the change of position that an imperfection causes, relative to the motion; of the
    velocity where it changes that alone. If `shifted`, parameters move by factors within `spread`.
    """
    k, c, b = bench.k, bench.c, bench.b
    if shifted:
        k, c, b = (n * by for n, by in zip((k, c, b), rng.uniform(*spread, 3), strict=True))
    elif bench.unshifted is not None:
        k, c, b = bench.unshifted
    machine = Machine(bench.kind, k, c, b, bench.limit, bounds=bench.bounds)
    plan = bench.recorded or [Plan("", _plan(bench, shape, rng), (0.0, 0.0)) for shape in SHAPES]
    size = _sizes(bench, machine, plan)
    gaps_made = []
    for name in names:
        wanted = float(np.exp(rng.uniform(*np.log(gaps))))
        shape = shape_of(name, size, rng, hardens=bench.kind == "inertia")
        machine, reached = as_large_as(
            machine,
            name,
            shape,
            wanted,
            lambda m: _seen(bench, m, plan),
            int(name == "velocity_lag"),
        )
        gaps_made.append(reached)
    sigma = bench.sigma or (bench.noise * size["position"], bench.noise * 1.5 * size["velocity"])
    if "sensor_quantization" in names:
        sigma = (sigma[0] * 0.3, sigma[1] * 0.3)
    rates = bench.timestep_s, bench.parts
    runs = [
        (
            p.role,
            run(
                machine,
                bench.led_in(p.series),
                *rates,
                sigma,
                rng,
                p.start,
                bench.warm_up,
                bench.feedback,
                bench.law,
                ramped=bench.ramped,
            ),
        )
        for p in _plans(bench, size, rng)
    ]
    return SimulatedTrial(machine, shifted, min(gaps_made, default=0.0), np.array(sigma), runs)


def _plans(
    bench: JointBench, size: Mapping[str, float], rng: np.random.Generator
) -> Iterator[Plan]:
    """The plans of the recordings: the bench's recorded ones, with those of validation backwards as
    a test; or else drawn series, which start near rest about the middle."""
    if bench.recorded:
        yield from bench.recorded
        for p in bench.recorded:
            if p.role == "validation":
                yield Plan(
                    "test",
                    np.ascontiguousarray(p.series[::-1]),
                    (float(p.series[-1]), 0.0) if bench.feedback else p.start,
                )
        return
    for i, role in zip(
        (0, 1, 2, 3, 0, 2, 0, 1, 2, 3),
        ["adaptation"] * 4 + ["validation"] * 2 + ["test"] * 4,
        strict=True,
    ):
        series = _plan(bench, SHAPES[i], rng)
        yield Plan(
            role,
            series,
            (0.3 * rng.normal() * size["position"], 0.3 * rng.normal() * size["velocity"]),
        )


def _plan(bench: JointBench, shape: str, rng: np.random.Generator) -> Array:
    return bench.reach * planned(
        shape, round(bench.duration_s / bench.timestep_s) + 1 + bench.warm_up, bench.timestep_s, rng
    )


def _record(bench: JointBench, machine: Machine, plan: Sequence[Plan]) -> list[Run]:
    quiet = np.random.default_rng(0)
    return [
        run(
            machine,
            bench.led_in(p.series),
            bench.timestep_s,
            bench.parts,
            (0.0, 0.0),
            quiet,
            p.start,
            bench.warm_up,
            bench.feedback,
            ramped=bench.ramped,
        )
        for p in plan
    ]


def _seen(bench: JointBench, machine: Machine, plan: Sequence[Plan]) -> Array:
    return np.concatenate([r.observed for r in _record(bench, machine, plan)])


def _sizes(bench: JointBench, machine: Machine, plan: Sequence[Plan]) -> dict[str, float]:
    runs = _record(bench, machine, plan)
    y = np.concatenate([r.observed for r in runs])
    u = np.concatenate([r.issued for r in runs])
    return {
        "position": float(y[:, 0].std()), "velocity": float(y[:, 1].std()),
        "travel": float(np.abs(y[:, 0]).max()),
        "acceleration": float(machine.b * u.std()), "command": float(np.abs(u).max()),
        "time": float(y[:, 0].std() / y[:, 1].std()),
    }  # fmt: skip
