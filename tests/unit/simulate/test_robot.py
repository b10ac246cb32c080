"""The second simulator's robots: MuJoCo's own links, laws that are those of one joint, and steps
that converge."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from tests.support.robots import ARM, EVERYTHING, arm_machine, arm_plant
from trueup.model.mjcf import mujoco as engine
from trueup.model.mjcf import tree_of
from trueup.simulate.magnitude import as_large_as
from trueup.simulate.robot import Follow, RobotMachine, RobotPlan, rotor, run
from trueup.simulate.robot_mjcf import mjcf

PERIOD_S = 0.004


@pytest.fixture(scope="module")
def plan(tmp_path_factory):
    arm_plant(tmp_path_factory.mktemp("arm"))
    t = np.arange(500) * PERIOD_S
    q = np.stack([0.4 * np.sin(4.0 * t), 0.3 * np.cos(6.0 * t)], axis=1)
    v = np.gradient(q, PERIOD_S, axis=0)
    u = np.stack([9.0 + 4.0 * np.sin(4.0 * t), 2.0 + np.cos(7.0 * t)], axis=1)
    return RobotPlan("adaptation", u, np.concatenate([q, v], axis=1))


@pytest.fixture(scope="module")
def machine():
    return arm_machine()


FOLLOW = Follow(np.array([30.0, 10.0]), np.array([3.0, 1.0]))


def seen(machine, plan, parts=16):
    return run(machine, plan, PERIOD_S, parts, np.zeros(4), np.random.default_rng(0), 50, FOLLOW)


@pytest.mark.parametrize("text", [ARM, EVERYTHING])
def test_a_tree_written_as_mjcf_moves_as_the_file_it_came_from(text):
    given = mujoco.MjModel.from_xml_string(text)
    given.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    again = mujoco.MjModel.from_xml_string(
        mjcf(tree_of(engine(), given), float(given.opt.timestep))
    )
    one, other = mujoco.MjData(given), mujoco.MjData(again)
    order = [given.joint(int(a[0])).name for a in given.actuator_trnid]
    at = [[given.joint(j).name for j in range(given.njnt)].index(name) for name in order]
    for i in range(300):
        one.ctrl[:] = np.sin(0.02 * i + np.arange(given.nu))
        other.ctrl[:] = 0.0
        other.ctrl[at] = one.ctrl
        mujoco.mj_step(given, one)
        mujoco.mj_step(again, other)
    np.testing.assert_allclose(other.qpos, one.qpos, atol=1e-9)


@pytest.mark.parametrize("soft", [False, True])
def test_fine_steps_converge_with_their_square(machine, plan, soft):
    if soft:
        values = {"stiffness": 60.0, "damping": 0.2, "share": rotor(machine.tree, 0)}
        machine = machine.having("elastic_transmission", values, 0)
    exact = seen(machine, plan, 64).observed
    coarse, fine = (np.abs(seen(machine, plan, parts).observed - exact).max() for parts in (4, 8))
    assert fine < 0.3 * coarse


def test_dry_friction_holds_a_joint_that_is_pushed_by_less(machine):
    still = RobotPlan("test", np.zeros((200, 2)), np.zeros((200, 4)))
    # no gravity
    flat = replace(
        machine, tree=replace(machine.tree, constants=machine.tree.constants * (np.arange(21) < 18))
    )
    pushed = replace(still, commands=np.full((200, 2), 0.5))
    held = flat.having("coulomb_friction", {"level": 0.6}, 0).having(
        "coulomb_friction", {"level": 0.6}, 1
    )
    moved = run(held, pushed, PERIOD_S, 8, np.zeros(4), np.random.default_rng(0)).observed
    free = run(flat, pushed, PERIOD_S, 8, np.zeros(4), np.random.default_rng(0)).observed
    assert np.abs(moved[:, :2]).max() < 1e-6
    assert np.abs(free[:, :2]).max() > 0.05


def test_what_acts_on_a_log_acts_at_every_joint_and_a_drive_at_its_own(machine, plan):
    lost = seen(machine.having("dropped_frames", {"fraction": 0.3}, 0), plan).observed
    repeated = (np.diff(lost, axis=0) == 0.0).mean(axis=0)
    assert (repeated > 0.2).all()
    alone = [
        run(m, plan, PERIOD_S, 8, np.zeros(4), np.random.default_rng(0)).observed
        for m in (machine, machine.having("sensor_bias", {"bias": 0.1}, 1))
    ]
    np.testing.assert_allclose(
        alone[1] - alone[0], np.array([0.0, 0.1, 0.0, 0.0]) * np.ones((500, 1)), atol=1e-12
    )
    clipped = plan.commands.copy()
    clipped[:, 0] = np.clip(clipped[:, 0], -2.0, 2.0)  # the other joint's go beyond, and stay
    saturated, expected = (
        run(m, p, PERIOD_S, 8, np.zeros(4), np.random.default_rng(0)).observed
        for m, p in (
            (machine.having("saturation", {"limit": 2.0}, 0), plan),
            (machine, replace(plan, commands=clipped)),
        )
    )
    np.testing.assert_allclose(saturated, expected, atol=1e-9)
    assert np.abs(saturated - alone[0]).max() > 0.1


def test_a_rotor_behind_a_spring_is_part_of_the_armature(machine, plan):
    largest = rotor(machine.tree, 0)
    assert 0.0 < largest < 0.02
    stiff = {"stiffness": 2e4, "damping": 2.0, "share": largest}
    soft = {"stiffness": 40.0, "damping": 0.2, "share": largest}
    plain = seen(machine, plan).observed
    off = [
        np.abs(seen(machine.having("elastic_transmission", values, 0), plan).observed - plain).max()
        for values in (stiff, soft)
    ]
    assert off[0] < 0.1 * off[1]


def test_a_rotor_gets_no_more_than_its_actuator_gives():
    text = ARM.replace(
        '<motor joint="shoulder"/>', '<position joint="shoulder" kp="40" kv="2" forcerange="-3 3"/>'
    )
    tree = tree_of(
        engine(),
        mujoco.MjModel.from_xml_string(text.replace('gravity="0 0 -9.81"', 'gravity="0 0 0"')),
    )
    servo = RobotMachine(tree, np.full(2, -25.0), np.full(2, 25.0), np.full(2, 25.0))
    goal = RobotPlan("test", np.tile([1.0, 0.0], (60, 1)), np.zeros((60, 4)))
    soft = servo.having(
        "elastic_transmission", {"stiffness": 80.0, "damping": 0.3, "share": rotor(tree, 0)}, 0
    )
    ways = [
        run(m, goal, PERIOD_S, 16, np.zeros(4), np.random.default_rng(0)).observed[-1, 0]
        for m in (servo, soft)
    ]
    assert ways[0] > 0.05
    assert ways[1] == pytest.approx(ways[0], rel=0.3)


def test_an_imperfection_that_makes_the_machine_shake_is_too_large(machine):
    still = np.sin(np.linspace(0.0, 9.0, 50))[:, None] * np.ones((1, 4))

    def observe(tried):
        level = tried.imperfections.get(("constant_force", 0), {"level": 0.0})["level"]
        # the velocity grows far more than the position
        return still * (1.0 + np.array([0.1, 0.0, 3.0, 0.0]) * level)

    def drawn(wanted):
        return as_large_as(
            machine, "constant_force", {"level": (0.0, 1.0, False)}, wanted, observe, 0
        )

    calm, reached = drawn(0.01)
    assert calm.imperfections["constant_force", 0]["level"] == pytest.approx(0.1, rel=0.15)
    assert reached == pytest.approx(0.01, rel=0.15)
    shaken, reached = drawn(0.09)  # at which the velocity would be four times what it was
    assert shaken.imperfections["constant_force", 0]["level"] == pytest.approx(0.5 / 3.0, rel=0.01)
    assert reached < 0.02
