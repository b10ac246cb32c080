"""Rigid bodies of a block of lanes: as regressors on arrays say, and as a joint can move."""

import numpy as np
import pytest

from tests.support.robots import EVERYTHING
from trueup.model import rigid_body
from trueup.model.block import BLOCK
from trueup.model.dry_friction import project_friction
from trueup.model.inverse import invert, invert_lanes
from trueup.model.mjcf import compile_file
from trueup.model.tree import ARMATURE, GAIN, JOINT, LIMIT, LINK, OFFSET, SERVO
from trueup.model.tree_regressors import inverse_dynamics, mass_matrix


@pytest.fixture(scope="module")
def tree(tmp_path_factory):
    path = tmp_path_factory.mktemp("robot") / "robot.xml"
    path.write_text(EVERYTHING)
    return compile_file(path).tree


@pytest.fixture(scope="module")
def lanes(tree):
    """Positions and velocities `(joints, lanes)`, the lanes' parameters, and their links."""
    joints = len(tree.joints)
    q, v = np.random.default_rng(3).normal(size=(2, joints, BLOCK))
    p = np.repeat(np.array(tree.parameters)[:, None], BLOCK, axis=1)
    mass = np.zeros((joints, joints * BLOCK))
    links = np.zeros((joints, rigid_body.LINK_ROWS * BLOCK))
    rigid_body.crba(tree.constants, p, q, links, mass)
    return q, v, p, links, mass


def test_the_mass_matrix_by_composite_bodies_is_the_regressors(tree, lanes):
    q, *_, mass = lanes
    joints = len(tree.joints)
    by_lane = mass.reshape(joints, joints, BLOCK).transpose(2, 0, 1)
    np.testing.assert_allclose(by_lane, mass_matrix(tree, q.T), atol=1e-12)


def test_the_bias_force_is_that_of_no_acceleration(tree, lanes):
    q, v, _, links, _ = lanes
    force = np.zeros_like(q)
    rigid_body.rnea(tree.constants, v, links, force)
    expected = inverse_dynamics(tree, q.T, v.T, np.zeros_like(q.T))
    np.testing.assert_allclose(force.T, expected, atol=1e-12)


def test_an_armature_is_added_to_its_own_joint_alone(tree, lanes):
    q, _, p, links, mass = lanes
    joints, more = len(tree.joints), p.copy()
    more[LINK * joints + JOINT * 1 + ARMATURE] += 0.25
    heavier = np.zeros_like(mass)
    rigid_body.crba(tree.constants, more, q, links.copy(), heavier)
    added = (heavier - mass).reshape(joints, joints, BLOCK)
    assert added[1, 1] == pytest.approx(0.25)
    added[1, 1] = 0.0
    assert not added.any()


def test_cosines_and_sines_hold_for_many_turns():
    angles = np.linspace(-40.0, 40.0, BLOCK)
    link = np.zeros(2 * BLOCK)
    link[:BLOCK] = angles
    rigid_body.cosines_and_sines(link)
    np.testing.assert_allclose(link[:BLOCK], np.cos(angles), atol=1e-14)
    np.testing.assert_allclose(link[BLOCK:], np.sin(angles), atol=1e-14)


def test_an_actuator_gives_no_more_than_its_limit(tree, lanes):
    q, _, p, *_ = lanes
    joints, constants = len(tree.joints), tree.constants.copy()
    constants[:, LIMIT], still = 0.5, np.zeros_like(q)
    free = constants.copy()
    free[:, LIMIT] = 1e30
    push, force, unlimited = np.full_like(q, 100.0), np.zeros_like(q), np.zeros_like(q)
    rigid_body.joint_forces(constants, p, push, q, still, force)
    rigid_body.joint_forces(free, p, push, q, still, unlimited)
    for j in range(joints):
        first = LINK * joints + JOINT * j
        driven = p[first + GAIN] * 100.0 - p[first + SERVO] * q[j] + constants[j, OFFSET]
        np.testing.assert_allclose(unlimited[j] - force[j], driven - np.clip(driven, -0.5, 0.5))


@pytest.mark.parametrize(("held", "after"), [(0.0, 1.0), (0.3, 0.4), (0.5, 0.0), (9.0, 0.0)])
def test_dry_friction_brakes_a_joint_and_never_turns_it_back(held, after):
    """One joint of inertia 1/2: an impulse of 0.3 takes 0.6 of its velocity."""
    v = np.full((1, BLOCK), 1.0)
    impulse = np.zeros_like(v)
    project_friction(
        np.full((1, BLOCK), 2.0), np.full((1, BLOCK), held), v, impulse, np.zeros(BLOCK)
    )
    assert v == pytest.approx(after)
    assert np.abs(impulse).max() == pytest.approx((1.0 - after) / 2.0)


def test_friction_of_coupled_joints_stops_both():
    coupled = np.repeat(np.array([[2.0, 0.5], [0.5, 1.0]])[:, :, None], BLOCK, axis=2)
    v, impulse = np.repeat([[1.0], [-2.0]], BLOCK, axis=1), np.zeros((2, BLOCK))
    held = np.full((2, BLOCK), 50.0)
    project_friction(coupled.reshape(2, -1), held, v, impulse, np.zeros(BLOCK))
    assert np.abs(v).max() < 1e-6


def test_inverses_of_lanes_are_those_of_each_matrix():
    n, rng = 4, np.random.default_rng(1)
    roots = rng.normal(size=(BLOCK, n, n))
    matrices = roots @ roots.transpose(0, 2, 1) + np.eye(n)
    lanes = matrices.transpose(1, 2, 0).reshape(n, -1).copy()
    invert_lanes(lanes, np.zeros((2, n * BLOCK)))
    one = np.zeros((n, n))
    invert(matrices[0].copy(), one)
    inverses = lanes.reshape(n, n, BLOCK).transpose(2, 0, 1)
    np.testing.assert_allclose(inverses, np.linalg.inv(matrices), rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(one, inverses[0], rtol=1e-12, atol=1e-14)
