"""Robot: a tree of joints with known imperfections, its rigid bodies simulated by MuJoCo on a step
far finer than its log.

The laws at a joint are those of `machine`, for generalised forces. In a fine step, positions drift
by half the step. MuJoCo says how the velocities change there, from the velocities in the middle of
the step, which are extrapolated from the last one. Then positions drift by another half. Dry
friction is MuJoCo's friction loss, made as hard as it can be. A skewed clock and lost frames act on
the whole log, so at every joint alike.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from trueup.model.mjcf import mujoco
from trueup.model.tree import ARMATURE, FRICTION, GAIN, LIMIT, OFFSET, SERVO, Tree
from trueup.simulate.machine import (
    FIRST,
    M_LAG,
    M_PLAY,
    M_RATE,
    M_SLOW,
    M_TWIST,
    M_TWIST_SPEED,
    MEMORY,
    S_ELASTIC,
    S_SKEW,
    S_SPEED,
    S_VASYM,
    SIZE,
    SLOTS,
    Run,
    arriving,
    driven,
    observed_velocity,
    pulling,
    sensed,
    sticking,
    stored,
)
from trueup.simulate.robot_mjcf import mjcf

Array = NDArray[np.float64]
# At a servo these act on its error.
OF_DRIVE = ("saturation", "deadband", "gain_asymmetry", "thermal_derating", "quadratic_gain")
OF_LOG = ("clock_skew", "dropped_frames")
# These change a family's own spring, and a robot's joints have none to speak of.
OF_A_SPRING = ("k_modulated", "asymmetric_stiffness")
ROTOR = 0.8  # of a joint's armature, at most, is a rotor behind a spring


@dataclass(frozen=True)
class RobotMachine:
    """A robot: its true numbers, the limits of its commands `(joints,)`, the size of each joint's
    drive, and what else is wrong with it, by effect and joint."""

    tree: Tree
    low: Array
    high: Array
    drive: Array
    imperfections: Mapping[tuple[str, int], Mapping[str, float]] = field(default_factory=dict)

    def having(self, name: str, values: Mapping[str, float], joint: int = 0) -> RobotMachine:
        """The robot with one more imperfection."""
        return replace(self, imperfections={**self.imperfections, (name, joint): values})

    def by_joint(self) -> Mapping[tuple[str, int], Mapping[str, float]]:
        """The imperfections' numbers, by effect and joint."""
        return self.imperfections

    def parameters(self) -> dict[str, float]:
        """None: a log shows sums of a robot's masses."""
        return {}

    def vectors(self) -> tuple[Array, NDArray[np.bool_]]:
        """The imperfections' numbers by joint, and which there are, `(joints, SIZE)`."""
        joints = len(self.tree.joints)
        numbers, present = np.zeros((joints, SIZE)), np.zeros((joints, SIZE), np.bool_)
        for (name, joint), values in self.imperfections.items():
            for offset, key in enumerate(SLOTS[name]):
                at = (slice(None) if name in OF_LOG else joint, FIRST[name] + offset)
                numbers[at], present[at] = values[key], True
        return numbers, present


@dataclass(frozen=True)
class Follow:
    """u = planned + kp (reference - position) + kd (its velocity - velocity), on observed values,
    `(joints,)` each."""

    kp: Array
    kd: Array


@dataclass(frozen=True)
class RobotPlan:
    """One recording's commands `(samples, joints)`, and the states that they led to `(samples, 2 x
    joints)`: it starts from the first.
    """

    role: str
    commands: Array
    reached: Array

    def backwards(self, role: str) -> RobotPlan:
        """The plan in reverse, with reversed velocities."""
        reached = self.reached[::-1].copy()
        reached[:, reached.shape[1] // 2 :] *= -1.0
        return RobotPlan(role, np.ascontiguousarray(self.commands[::-1]), reached)

    def led_in(self, samples: int) -> RobotPlan:
        """The plan with a lead-in of `samples`, so that the robot is under way when the log begins:
        its own beginning, backwards."""
        way = RobotPlan(
            self.role, self.commands[1 : samples + 1], self.reached[1 : samples + 1]
        ).backwards(self.role)
        return RobotPlan(
            self.role,
            np.concatenate([way.commands, self.commands]),
            np.concatenate([way.reached, self.reached]),
        )


def run(
    machine: RobotMachine, plan: RobotPlan, timestep_s: float, parts: int, sigma: Array,
    rng: np.random.Generator,
    warm_up: int = 0, follow: Follow | None = None,
) -> Run:  # fmt: skip
    """Run a robot on a plan. The log begins after `warm_up` samples; a sample is `parts` fine
    steps."""
    engine = mujoco()
    plan = plan.led_in(warm_up)
    numbers, present = machine.vectors()
    h = timestep_s * (1.0 + numbers[0, S_SKEW]) / parts
    model = engine.MjModel.from_xml_string(mjcf(machine.tree, h))
    data = engine.MjData(model)
    joints, total = len(machine.tree.joints), len(plan.commands)
    _make_room_for_rotors(model, numbers, present)
    drive = _Drive(numbers, present, machine, h, parts, total)
    drive.begin(plan.reached[0], plan.commands[0])
    data.qpos[:], data.qvel[:] = plan.reached[0, :joints], plan.reached[0, joints:]
    noise, lost = rng.normal(size=(total, 2 * joints)) * sigma, rng.random(total)
    issued, observed = np.zeros((total, joints)), np.zeros((total, 2 * joints))
    gained = np.zeros(joints)
    for i in range(total):
        last = observed[i - 1] if i else observed[0]
        drive.see(
            i * parts, (i - warm_up) * timestep_s, noise[i], lost[i], last, i == 0, observed[i]
        )
        u = plan.commands[i]
        if follow is not None:
            missed = plan.reached[i] - observed[i]
            u = u + follow.kp * missed[:joints] + follow.kd * missed[joints:]
        issued[i] = np.clip(u, machine.low, machine.high)
        for part in range(parts):
            before = data.qvel.copy()
            data.qpos += 0.5 * h * before
            data.qvel += 0.5 * gained
            drive.act(i * parts + part, (i - warm_up) * timestep_s, issued[i], gained, data)
            model.dof_frictionloss[:] = drive.friction
            for stage in (engine.mj_fwdPosition, engine.mj_fwdVelocity):
                stage(model, data)
            # friction that holds ends the step at rest
            data.efc_aref[:] = -before[drive.friction > 0.0] / h
            for stage in (
                engine.mj_fwdActuation,
                engine.mj_fwdAcceleration,
                engine.mj_fwdConstraint,
            ):
                stage(model, data)
            gained = h * data.qacc
            data.qvel[:] = before + gained
            data.qpos += 0.5 * h * data.qvel
            drive.moved(i * parts + part, gained, data)
    logged = slice(warm_up, total)
    return Run(
        np.asarray(np.arange(total - warm_up) * timestep_s, np.float64),
        issued[logged].copy(),
        observed[logged].copy(),
    )


class _Drive:
    """The imperfections at the joints of a robot, between the commands and MuJoCo."""

    def __init__(
        self,
        numbers: Array,
        present: NDArray[np.bool_],
        machine: RobotMachine,
        h: float,
        parts: int,
        samples: int,
    ) -> None:
        joints, steps = len(numbers), samples * parts + 1
        of_drive = np.zeros(SIZE, np.bool_)
        for name in OF_DRIVE:
            of_drive[FIRST[name] : FIRST[name] + len(SLOTS[name])] = True
        self.of_joints = (numbers, present, present & of_drive, present & ~of_drive)
        self.own = (
            np.column_stack(
                [
                    machine.tree.at_joint[:, [GAIN, SERVO, FRICTION]],
                    machine.tree.constants[:, LIMIT],
                ]
            ),
            np.ascontiguousarray(machine.tree.constants[:, OFFSET]),
            machine.drive,
            h,
        )
        self.memory = np.zeros((joints, MEMORY))
        self.q, self.v, self.u = (
            np.zeros((joints, steps)),
            np.zeros((joints, steps)),
            np.zeros((joints, steps)),
        )
        self.friction = np.zeros(joints)

    def begin(self, state: Array, issued: Array) -> None:
        """Start from a state `(2 x joints,)`, with drives that have settled at their commands."""
        joints = len(self.friction)
        self.memory[:, [M_PLAY, M_LAG, M_RATE]] = issued[:, None]
        self.q[:, 0], self.v[:, 0], self.memory[:, M_SLOW] = (
            state[:joints],
            state[joints:],
            state[joints:],
        )

    def see(
        self, k: int, now: float, noise: Array, luck: float, last: Array, first: bool, out: Array
    ) -> None:
        """Write what the log records at fine step `k` to `out`, `(2 x joints,)`."""
        _see(
            self.of_joints[0],
            self.of_joints[1],
            self.q,
            self.v,
            k,
            self.own[3],
            now,
            noise,
            luck,
            last,
            first,
            out,
        )

    def act(self, k: int, now: float, issued: Array, gained: Array, data: Any) -> None:
        """Set MuJoCo's controls and forces, and the friction at each joint. `gained` is the
        velocity that the last fine step gave."""
        _act(
            *self.of_joints, *self.own, self.memory, self.u, k, now, issued, data.qpos, data.qvel,
            gained, data.qfrc_bias, data.ctrl,
            data.qfrc_applied, self.friction,
        )  # fmt: skip

    def moved(self, k: int, gained: Array, data: Any) -> None:
        """Take in the state after fine step `k`."""
        _moved(
            self.of_joints[0],
            self.of_joints[1],
            self.own[3],
            self.memory,
            self.q,
            self.v,
            k,
            data.qpos,
            data.qvel,
            gained,
        )


@njit(cache=True)
def _see(n, has, q, v, k, h, now, noise, luck, last, first, out):  # type: ignore[no-untyped-def]
    joints = len(n)
    for j in range(joints):
        seen_q, seen_v = sensed(n[j], q[j], v[j], k, h, now)
        seen_q, seen_v = seen_q + noise[j], seen_v + noise[joints + j]
        out[j], out[joints + j] = stored(
            n[j], has[j], seen_q, seen_v, luck, last[j], last[joints + j], first
        )


@njit(cache=True)
def _act(  # type: ignore[no-untyped-def]
    n, has, of_drive, of_goal, own, offset, size, h, m, fine_u, k, now, issued, q, v, gained,
    bias, ctrl, applied, friction,
):  # fmt: skip
    for j in range(len(n)):
        gain, servo, rubs, most = own[j, 0], own[j, 1], own[j, 2], own[j, 3]
        fine_u[j, k] = issued[j]
        u = arriving(n[j], fine_u[j], k, h)
        rest = (servo * q[j] - offset[j]) / gain if gain != 0.0 else 0.0
        if servo != 0.0:
            u = driven(n[j], of_goal[j], m[j], u, h, True, size[j])
            u = rest + driven(n[j], of_drive[j], m[j], u - rest, h, True, size[j])
        else:
            u = driven(n[j], has[j], m[j], u, h, True, size[j])
        x, w = q[j], v[j]
        drive = min(max(gain * (u - rest), -most), most)
        force = (
            pulling(n[j], has[j], m[j], 0.0, x, w, h)
            - n[j, S_VASYM] * abs(w)
            - drive * min(1.0, n[j, S_SPEED] * abs(w))
        )
        if has[j, S_ELASTIC]:
            stiffness, damping, inertia = n[j, S_ELASTIC], n[j, S_ELASTIC + 1], n[j, S_ELASTIC + 2]
            m[j, M_TWIST] += 0.5 * h * m[j, M_TWIST_SPEED]
            foretold = (
                m[j, M_TWIST_SPEED]
                - 0.5 * gained[j]
                + 0.5 * h * (drive - stiffness * m[j, M_TWIST]) / inertia
            )
            coupling = stiffness * m[j, M_TWIST] + damping * foretold / (
                1.0 + 0.5 * h * damping / inertia
            )
            m[j, M_TWIST_SPEED] += h * (drive - coupling) / inertia
            force += coupling - drive
        ctrl[j], applied[j] = u, force
        friction[j] = rubs + sticking(n[j], has[j], w, drive + bias[j], now)


@njit(cache=True)
def _moved(n, has, h, m, fine_q, fine_v, k, q, v, gained):  # type: ignore[no-untyped-def]
    for j in range(len(n)):
        if has[j, S_ELASTIC]:
            m[j, M_TWIST_SPEED] -= gained[j]
            m[j, M_TWIST] += 0.5 * h * m[j, M_TWIST_SPEED]
        fine_q[j, k + 1], fine_v[j, k + 1] = (
            q[j],
            observed_velocity(n[j], has[j], m[j], v[j], gained[j], h),
        )


def _make_room_for_rotors(model: Any, numbers: Array, present: NDArray[np.bool_]) -> None:
    """A rotor behind a spring is no part of its joint's armature."""
    soft = present[:, S_ELASTIC]
    model.dof_armature[soft] -= numbers[soft, S_ELASTIC + 2]


def rotor(tree: Tree, joint: int) -> float:
    """The largest rotor that a joint's armature has room for [kg m^2, kg]."""
    return ROTOR * float(tree.at_joint[joint, ARMATURE])
