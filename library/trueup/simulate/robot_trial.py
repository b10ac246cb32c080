"""Simulated trials of robots: a randomly drawn robot, its imperfections and its recordings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from trueup.model.tree import DAMPING, FRICTION, Tree
from trueup.simulate.machine import Run
from trueup.simulate.magnitude import as_large_as, shape_of
from trueup.simulate.robot import OF_DRIVE, Follow, RobotMachine, RobotPlan, rotor, run
from trueup.simulate.trial import SimulatedTrial

Array = NDArray[np.float64]


@dataclass(frozen=True)
class RobotBench:
    """A `Bench` of one robot: its numbers, rates and noise, and what was recorded. A second before
    each log is not logged.

    `drive` `(joints,)` is the largest declared command, `asked` the largest command, or error of a
    servo, that each joint's drive was given; `force` the force of its motion; `sigma`
    `(2 x joints,)` the noise.
    """

    robot: ClassVar[bool] = True

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

    def record(
        self, machine: RobotMachine, plan: RobotPlan, sigma: Array, rng: np.random.Generator
    ) -> Run:
        """What a robot does on a plan."""
        return run(
            machine, plan, self.timestep_s, self.parts, sigma, rng, self.warm_up, self.feedback
        )

    def relative_noise(self) -> float:
        """The noise over the standard deviation of the motion, of the noisiest channel."""
        motion = np.concatenate([p.reached for p in self.recorded]).std(axis=0)
        return float(np.max(self.sigma / motion))

    def draw(
        self,
        imperfections: Sequence[tuple[str, int]],
        shifted: bool,
        rng: np.random.Generator,
        gaps: tuple[float, float],
        spread: tuple[float, float],
    ) -> SimulatedTrial:
        """A robot recorded by the bench's plans, and by those of validation backwards.

        The gap that sizes an imperfection is the change of the joint's position, or velocity where
        it changes that alone, on the plan in which the joint moves most. If `shifted`, masses with
        their moments, dampings and friction losses move by factors within `spread`, each link's
        and joint's its own.
        """
        machine, joints = self.machine, len(self.tree.joints)
        if shifted:
            machine = replace(machine, tree=_moved(self.tree, rng, spread))
        sigma, gaps_made = self.sigma, []

        def observe(tried: RobotMachine, joint: int) -> Array:
            most = max(self.recorded, key=lambda p: float(p.reached[:, joint].std()))
            return self.record(tried, most, np.zeros(2 * joints), np.random.default_rng(0)).observed

        for name, joint in imperfections:
            wanted = float(np.exp(rng.uniform(*np.log(gaps))))
            size = _sizes(self, name, joint)
            shape = shape_of(name, size, rng, hardens=True)
            if name == "elastic_transmission":  # the rotor is part of the armature
                largest = rotor(machine.tree, joint)
                shape |= {
                    "share": (largest, 0.0, False),
                    "stiffness": (40.0 * largest / size["time"] ** 2, 0.0, True),
                }
                shape |= {"damping": (0.15 * largest / size["time"], 0.0, False)}
            column = joints + joint if name == "velocity_lag" else joint
            machine, reached = as_large_as(
                machine, name, shape, wanted, partial(observe, joint=joint), column, joint
            )
            gaps_made.append(reached)
            if name == "sensor_quantization":
                sigma = np.where(np.arange(2 * joints) % joints == joint, 0.3 * sigma, sigma)
        plans = [
            *self.recorded,
            *(p.backwards("test") for p in self.recorded if p.role == "validation"),
        ]
        gap = min(gaps_made, default=0.0)
        return SimulatedTrial(
            machine,
            shifted,
            gap,
            sigma,
            [(p.role, self.record(machine, p, sigma, rng)) for p in plans],
        )


def _moved(tree: Tree, rng: np.random.Generator, spread: tuple[float, float]) -> Tree:
    """Other masses, dampings and friction losses."""
    joints = len(tree.joints)
    links, at_joint = tree.links * rng.uniform(*spread, (joints, 1)), tree.at_joint
    at_joint[:, [DAMPING, FRICTION]] *= rng.uniform(*spread, (joints, 2))
    return replace(tree, parameters=tuple(float(x) for x in [*links.ravel(), *at_joint.ravel()]))


def _sizes(bench: RobotBench, name: str, joint: int) -> dict[str, float]:
    """Sizes of one joint's motion and forces, as recorded, and of the command that an effect acts
    on: a servo's goal, or its error."""
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
