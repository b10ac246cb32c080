"""Does the monitor keep its promise, and does it find quiet drifts in time?

promise  machines that stay healthy, with noise half of which is correlated in time: 200 reference
         runs, then fresh ones; alarms of each detector with the exact Poisson interval
drift    every effect of the catalogue grows over 20 episodes to a quarter of the gap that blind
         trials hide (0.17 of the motion, the middle of their range); the serving model is what a
         diagnosis made of the healthy machine. In time is in an episode before the first on whose
         machine the rollout error, on recordings of their own, has doubled. Where it has in the
         first episode already there is no before, and what counts is an alarm in that one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench.report import Figure, show
from tests.support.simulated import episode_of, plant_of
from trueup.diagnose.diagnosis import diagnose
from trueup.episode.role import Role
from trueup.monitor.achieved import poisson_interval
from trueup.monitor.detector import detectors
from trueup.monitor.monitor import Monitor, calibrate
from trueup.monitor.residuals import unscaled_residuals
from trueup.simulate.excitation import SHAPES, planned
from trueup.simulate.machine import Machine, Run, run
from trueup.simulate.magnitude import as_large_as, shape_of
from trueup.simulate.trial import CATALOGUE, JointBench, Plan, _seen, _sizes, draw_bench

SEED = 20261
TIERS = ("A0", "A1", "B1", "B2")
REFERENCE, EPISODES, JUDGED = 200, 20, 4
QUARTER = 0.25 * 0.17
PROMISE_H = 1.0
SLOW_S = 0.2  # correlation time of half of the noise's power
FRESH = 250
ON_INERTIA = ("sensor_bias", "sensor_drift")  # nothing there shows them


@dataclass
class Robot:
    """A healthy machine and how it is recorded."""

    bench: JointBench
    machine: Machine
    sigma: tuple[float, float]
    size: dict[str, float]
    plan: list[Plan]

    @staticmethod
    def draw(tier: str, rng: np.random.Generator) -> Robot:
        bench = draw_bench(tier, rng)
        machine = Machine(bench.kind, bench.k, bench.c, bench.b, bench.limit)
        plan = [Plan("", _series(bench, shape, rng), (0.0, 0.0)) for shape in SHAPES]
        size = _sizes(bench, machine, plan)
        noise = bench.noise or 0.002
        return Robot(
            bench, machine, (noise * size["position"], noise * 1.5 * size["velocity"]), size, plan
        )

    def record(self, machine: Machine, role: Role, rng: np.random.Generator, name: str):
        b = self.bench
        start = (
            0.3 * rng.normal() * self.size["position"],
            0.3 * rng.normal() * self.size["velocity"],
        )
        half = tuple(s / np.sqrt(2.0) for s in self.sigma)
        found = run(
            machine, _whole(b, rng), b.timestep_s, b.parts, half, rng, start, b.warm_up, b.feedback
        )
        slow, keep = rng.normal(size=found.observed.shape), np.exp(-b.timestep_s / SLOW_S)
        for i in range(1, len(slow)):
            slow[i] = keep * slow[i - 1] + np.sqrt(1.0 - keep * keep) * slow[i]
        return episode_of(
            plant_of(b), Run(found.t_s, found.issued, found.observed + slow * half), role, name
        )


def _whole(bench: JointBench, rng: np.random.Generator) -> np.ndarray:
    """An episode's commands: one series of each shape, in any order."""
    parts = [
        _series(bench, str(shape), rng)[: round(bench.duration_s / bench.timestep_s)]
        for shape in rng.permutation(SHAPES)
    ]
    return np.concatenate([parts[0][: bench.warm_up + 1], *parts])


def _series(bench: JointBench, shape: str, rng: np.random.Generator) -> np.ndarray:
    return bench.reach * planned(
        shape, round(bench.duration_s / bench.timestep_s) + 1 + bench.warm_up, bench.timestep_s, rng
    )


def served(robot: Robot, rng: np.random.Generator):
    """The model that a diagnosis makes of the healthy machine."""
    roles = [Role.ADAPTATION] * 2 + [Role.VALIDATION] * 2
    episodes = [robot.record(robot.machine, role, rng, f"{i}") for i, role in enumerate(roles)]
    return diagnose(plant_of(robot.bench), episodes).predictor


def watched(robot: Robot, predictor, rng: np.random.Generator) -> Monitor:
    episodes = [
        robot.record(robot.machine, Role.REFERENCE, rng, f"r{i:03d}") for i in range(REFERENCE)
    ]
    return calibrate(predictor, "", episodes, PROMISE_H)


def promise(robots) -> list[Figure]:
    """Alarms on fresh healthy runs, all machines together."""
    counts, hours, whole = dict.fromkeys(detectors(), 0), 0.0, 0
    for robot, predictor, monitor, rng in robots:
        state = monitor.begin()
        for i in range(FRESH):
            episode = robot.record(robot.machine, Role.REFERENCE, rng, f"f{i}")
            state, seen = monitor.follow(state, predictor, episode)
            hours += seen.seconds / 3600.0
            whole += bool(seen.alarms)
            for name in seen.alarms:
                counts[name] += 1
    figures = []
    for name, count in {**counts, "all together": whole}.items():
        low, high = (x / hours for x in poisson_interval(count))
        allowed = 1.0 / PROMISE_H if name == "all together" else 1.0 / PROMISE_H / len(detectors())
        figures.append(
            Figure(
                f"false alarms an hour, {name}",
                f"{count / hours:.2f} [{low:.2f}, {high:.2f}]",
                f"{allowed:g} promised, {hours:.0f} h",
                low <= allowed,
            )
        )
    return figures


def error(predictor, episodes) -> float:
    """Rollout error, rms over everything, normalised by each channel's motion."""
    motion = np.concatenate([e.observations for e in episodes]).std(axis=0)
    return float(
        np.sqrt(
            np.mean(
                np.concatenate(
                    [
                        (unscaled_residuals(predictor, e).values * predictor.plant.scales / motion)
                        ** 2
                        for e in episodes
                    ]
                )
            )
        )
    )


def drifts(robot: Robot, name: str, wanted: float, rng: np.random.Generator) -> list[Machine]:
    """The machine at each of the episodes of a drift."""
    seed = int(rng.integers(2**31))
    found = []
    for i in range(EPISODES):
        part = (i + 1) / EPISODES
        shape = shape_of(
            name, robot.size, np.random.default_rng(seed), hardens=robot.bench.kind == "inertia"
        )
        if name == "dropped_frames":
            shape = {"fraction": (part * 0.25 * shape["fraction"][0], 0.0, False)}
        column = int(name == "velocity_lag")
        machine, _ = as_large_as(
            robot.machine,
            name,
            shape,
            part * wanted,
            lambda m: _seen(robot.bench, m, robot.plan),
            column,
        )
        found.append(machine)
    return found


def one(robot: Robot, predictor, monitor: Monitor, name: str, rng: np.random.Generator) -> dict:
    machines = drifts(robot, name, QUARTER, rng)

    def judged(machine):
        return [
            robot.record(machine, Role.TEST, np.random.default_rng(i), f"t{i}")
            for i in range(JUDGED)
        ]

    before = error(predictor, judged(robot.machine))
    doubled = next(
        (i for i, m in enumerate(machines) if error(predictor, judged(m)) >= 2.0 * before), None
    )
    state, alarms, seconds = monitor.begin(), {}, 0.0
    for i, machine in enumerate(machines):
        episode = robot.record(machine, Role.REFERENCE, rng, f"d{i}")
        state, seen = monitor.follow(state, predictor, episode)
        for d in seen.alarms:
            alarms.setdefault(d, (i, seen.alarms[d][1]))
        seconds += seen.seconds
    return {
        "effect": name,
        "kind": robot.bench.kind,
        "doubled": doubled,
        "alarms": alarms,
        "last": error(predictor, judged(machines[-1])) / before,
    }


def main() -> None:
    rng = np.random.default_rng(SEED)
    robots = []
    for tier in TIERS:
        robot = Robot.draw(tier, rng)
        predictor = served(robot, rng)
        robots.append((robot, predictor, watched(robot, predictor, rng), rng))
    show("Promise of the monitor", promise(robots))
    rows = [
        one(robot, predictor, monitor, name, rng)
        for robot, predictor, monitor, _ in robots
        for name in CATALOGUE
        if not (robot.bench.kind == "inertia" and name in ON_INERTIA)
    ]
    figures = [Figure(f"{r['effect']} ({r['kind']})", told(r)) for r in rows]
    show(
        "Drift of one effect",
        figures + [f for d in ("monitor", *detectors()) for f in in_time(d, rows)],
    )


def told(row: dict) -> str:
    doubled = "never" if row["doubled"] is None else f"at {row['doubled'] + 1}"
    return (
        f"alarm at {min((a[0] + 1 for a in row['alarms'].values()), default='none')}, "
        f"doubles {doubled}"
    )


def in_time(detector: str, rows: list[dict]) -> list[Figure]:
    """How often an alarm came before the error had doubled; of all detectors together, that is the
    monitor's own."""
    first = [
        min((a[0] for d, a in r["alarms"].items() if detector in ("monitor", d)), default=EPISODES)
        for r in rows
    ]
    doubled = [r["doubled"] for r in rows]
    slow = [(f, at) for f, at in zip(first, doubled, strict=True) if at]
    fast = [f for f, at in zip(first, doubled, strict=True) if at == 0]
    never = [f for f, at in zip(first, doubled, strict=True) if at is None]
    before = sum(f < at for f, at in slow)
    needed = detector == "monitor"
    return [
        Figure(
            f"{detector}: in time",
            f"{before}/{len(slow)}",
            ">= 95 %" if needed else "",
            before >= 0.95 * len(slow) if needed else None,
        ),
        Figure(
            f"{detector}: doubled in the first episode, alarm in it",
            f"{sum(f == 0 for f in fast)}/{len(fast)}",
        ),
        Figure(
            f"{detector}: never doubles, found", f"{sum(f < EPISODES for f in never)}/{len(never)}"
        ),
    ]


if __name__ == "__main__":
    main()
