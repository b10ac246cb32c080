"""A robot from MJCF or URDF: the same motion as MuJoCo's own, and refusals that say what to do."""

import importlib
import sys
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from tests.support.robots import ARM, EVERYTHING, URDF, arm_document, arm_plant
from trueup.errors import BadPlant, NotInstalled
from trueup.model.dynamics import CompiledTree
from trueup.model.fields import Reader
from trueup.model.mjcf import compile_file
from trueup.model.nominal_form import resolved
from trueup.model.plant import Plant
from trueup.model.tree import FRICTION, JOINT, LINK, Tree
from trueup.model.tree_regressors import inverse_dynamics, mass_matrix

ROUNDING = 1e-9
MANY = 40


def compiled(tmp_path, text, name="robot.xml"):
    (tmp_path / name).write_text(text)
    return compile_file(tmp_path / name)


@pytest.fixture
def everything(tmp_path):
    found = compiled(tmp_path, EVERYTHING)
    model = mujoco.MjModel.from_xml_string(EVERYTHING)
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    return found.tree, model, mujoco.MjData(model)


def test_mass_matrix_and_inverse_dynamics_are_mujocos(everything):
    tree, model, data = everything
    q, v, a = np.random.default_rng(0).normal(size=(3, MANY, model.nv))
    masses, forces = mass_matrix(tree, q), inverse_dynamics(tree, q, v, a)
    for i in range(MANY):
        data.qpos[:], data.qvel[:] = q[i], v[i]
        mujoco.mj_forward(model, data)
        full, needed = np.zeros((model.nv, model.nv)), np.zeros(model.nv)
        mujoco.mj_fullM(model, data, full)
        data.qacc[:] = a[i]
        mujoco.mj_rne(model, data, 1, needed)
        np.testing.assert_allclose(masses[i], full, atol=ROUNDING)
        np.testing.assert_allclose(forces[i], needed + model.dof_armature * a[i], atol=ROUNDING)


def test_a_rollout_is_mujocos_own_but_for_rounding(everything):
    """Branches, slides, springs, gears, servos, force limits, references and several joints of one
    body."""
    tree, model, data = everything
    samples, driven = 300, [tree.joints.index(j) for j in "abc"]
    applied = np.zeros((1, samples, len(tree.joints)))
    applied[0, :, driven] = np.sin(0.02 * np.arange(samples)) * np.array([[3.0], [1.0], [1.0]])
    steps = np.ones((1, samples), np.int64)
    found = CompiledTree(tree).rollout(
        np.array([tree.parameters]),
        np.zeros((1, 2 * len(tree.joints))),
        applied,
        np.full((1, samples), 0.002),
        steps,
    )[0, 0]
    data.qpos[:] = 0.0
    for i in range(samples - 1):
        data.ctrl[:] = applied[0, i, driven]
        mujoco.mj_step(model, data)
        np.testing.assert_allclose(
            found[i + 1], np.concatenate([data.qpos, data.qvel]), atol=ROUNDING
        )


def test_a_urdf_is_read_as_mujoco_reads_it(tmp_path):
    tree = compiled(tmp_path, URDF, "robot.urdf").tree
    assert tree.joints == ("first", "second")
    values = dict(zip(tree.parameter_names, tree.parameters, strict=True))
    assert values["mass(first)"] == pytest.approx(1.2)
    assert values["damping(first)"] == pytest.approx(0.1)


def test_a_tree_written_as_json_is_the_same_tree(tmp_path):
    tree = compiled(tmp_path, EVERYTHING).tree
    again = Tree.read(Reader.of(tree.document()))
    assert again.document() == tree.document()
    assert again.parameters == tree.parameters


def test_dry_friction_stops_a_joint_and_never_turns_it(tmp_path):
    tree = compiled(tmp_path, ARM).tree
    numbers = np.array(tree.parameters)
    numbers[LINK * 2 + FRICTION :: JOINT] = 0.4
    rubbing = replace(tree, parameters=tuple(numbers))
    # no gravity
    flat = replace(
        rubbing,
        constants=np.where(np.arange(rubbing.constants.shape[1]) >= 18, 0.0, rubbing.constants),
    )
    samples, dynamics = 800, CompiledTree(flat)
    states = dynamics.rollout(
        np.array([flat.parameters]), np.array([[0.0, 0.0, 1.0, -2.0]]), np.zeros((1, samples, 2)),
        np.full((1, samples), 0.004), np.ones((1, samples), np.int64),
    )[0, 0]  # fmt: skip
    q, v = states[:, :2], states[:, 2:]
    assert np.abs(v[-1]).max() < 1e-12
    masses = dynamics.inertia(np.array(flat.parameters), q) * dynamics.form.sizes[None, :, None]
    energy = np.einsum("ni,nij,nj->n", v, masses, v) / 2.0
    assert energy[0] > 0.05
    assert (np.diff(energy) <= 1e-9).all()
    at_rest = np.flatnonzero(np.abs(v).max(axis=1) < 1e-12)
    assert np.array_equal(at_rest, np.arange(at_rest[0], samples))  # and stays so


def test_what_is_left_out_is_said(tmp_path):
    assert compiled(tmp_path, EVERYTHING).left_out == ("contact",)
    assert compiled(tmp_path, ARM).left_out == ()


@pytest.mark.parametrize(
    ("written", "by", "said"),
    [
        ('axis="0 1 0" damping="0.3"', 'axis="0 1 0" range="-90 90" damping="0.3"', "joint limits"),
        ('<body name="lower"', '<body name="lower" gravcomp="1"', "gravity compensation"),
        ('integrator="implicitfast"', 'integrator="implicitfast" density="1"', "fluid forces"),
        (
            "</worldbody>",
            "</worldbody><equality><joint joint1='shoulder' joint2='elbow'/></equality>",
            "equality constraints",
        ),
        (
            "</worldbody>",
            "</worldbody><tendon><fixed><joint joint='elbow' coef='1'/></fixed></tendon>",
            "tendons",
        ),
    ],
)
def test_each_thing_that_a_rollout_does_not_do_is_named(tmp_path, written, by, said):
    assert written in ARM
    assert compiled(tmp_path, ARM.replace(written, by)).left_out == (said,)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (
            (
                "<mujoco><worldbody><body><joint name='x' type='ball'/><geom "
                "size='1'/></body></worldbody></mujoco>"
            ),
            "free or a ball",
        ),
        (
            "<mujoco><worldbody><body><freejoint/><geom size='1'/></body></worldbody></mujoco>",
            "free or a ball",
        ),
        ("<mujoco><worldbody><geom size='1'/></worldbody></mujoco>", "no joint"),
        ("<mujoco", "cannot read"),
        (ARM.replace("</actuator>", "<motor joint='elbow'/></actuator>"), "2 actuators"),
        (
            ARM.replace(
                '<motor joint="elbow"/>', '<intvelocity joint="elbow" actrange="-1 1" kp="3"/>'
            ),
            "neither a motor nor a servo",
        ),
    ],
)
def test_a_model_that_is_no_robot_of_joints_is_refused(tmp_path, text, says):
    with pytest.raises(BadPlant, match=says) as refused:
        compiled(tmp_path, text)
    assert refused.value.facts["field"] == "nominal.mjcf"


def test_without_mujoco_the_error_says_how_to_get_it(tmp_path, monkeypatch):
    def missing(name):
        raise ImportError(name)

    monkeypatch.setattr(importlib, "import_module", missing)
    with pytest.raises(NotInstalled) as refused:
        compiled(tmp_path, ARM)
    assert "trueup[mujoco]" in refused.value.hint


def test_a_model_outside_the_case_is_not_read(tmp_path):
    folder = tmp_path / "case"
    folder.mkdir()
    (tmp_path / "arm.xml").write_text(ARM)
    with pytest.raises(BadPlant, match="outside"):
        resolved(arm_document(nominal={"mjcf": "../arm.xml", "timestep_s": 0.004}), folder)


def test_a_plant_without_its_models_numbers_says_where_they_are_read():
    with pytest.raises(BadPlant) as refused:
        Plant.from_document(arm_document())
    assert refused.value.facts["field"] == "nominal.tree"


def test_a_resolved_plant_needs_no_mujoco(tmp_path, monkeypatch):
    plant = arm_plant(tmp_path)
    monkeypatch.setattr(importlib, "import_module", None)
    monkeypatch.setitem(sys.modules, "mujoco", None)  # which an import statement takes for missing
    again = Plant.from_document(plant.document)
    assert again.digest == plant.digest
    assert again.joints == ("shoulder", "elbow")


@pytest.mark.parametrize(
    ("change", "field"),
    [
        (lambda d: d["commands"][0].update(joint="wrist"), "commands"),
        (lambda d: d["observations"][0].update(joint="wrist"), "observations"),
        (lambda d: d["observations"].pop(1), "observations"),
        (lambda d: d["commands"][1].update(joint="shoulder"), "commands"),
        (lambda d: d["observations"][2].update(field="position"), "observations"),
    ],
)
def test_channels_that_do_not_fit_the_joints_are_refused(tmp_path, change, field):
    arm_plant(tmp_path)
    document = arm_document()
    change(document)
    with pytest.raises(BadPlant) as refused:
        Plant.from_document(resolved(document, tmp_path))
    assert refused.value.facts["field"] == field


def test_commands_reach_their_joints_whatever_their_order(tmp_path):
    document = arm_document()
    document["commands"].reverse()
    arm_plant(tmp_path)
    plant = Plant.from_document(resolved(document, tmp_path))
    np.testing.assert_array_equal(plant.applied(np.array([[1.0, 2.0]])), [[2.0, 1.0]])
