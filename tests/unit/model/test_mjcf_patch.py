"""A corrected robot as MJCF: MuJoCo then moves as the corrected model does, and what it cannot
express is said."""

import re
import subprocess
from pathlib import Path

import mujoco
import numpy as np
import pytest

from tests.support import made
from tests.support.robots import ARM, EVERYTHING, URDF, plant_of
from trueup.episode.episode import Episode
from trueup.episode.role import Role
from trueup.model.block import term
from trueup.model.dynamics import CompiledTree
from trueup.model.effect import Effect, Port, effects
from trueup.model.feasible import feasible
from trueup.model.mjcf_patch import patch
from trueup.model.mjcf_writer import tags, write
from trueup.model.series import Scheme
from trueup.model.tree import LINK
from trueup.model.tree_regressors import inverse_dynamics
from trueup.model.windows import cut

SAMPLES = 250
EXPRESSED = 0.05  # of what a correction changes: the rest is half a step of a filter
NATIVE = {
    "coulomb_friction": {"level": 0.4},
    "quadratic_drag": {"coefficient": 3.0},
    "cubic_stiffness": {"coefficient": 8.0},
    "constant_force": {"level": 2.0},
    "saturation": {"limit": 1.0},
    "actuator_lag": {"time_constant": 0.05},
    "actuator_delay": {"delay": 0.016},
    "rate_limit": {"rate": 12.0},
    "cogging": {"sine": 0.6, "cosine": -0.8, "pitch": 0.11},
    "hysteresis": {"level": 0.8, "distance": 0.05, "shape": 1.0, "sharpness": 0.0},
    "elastic_transmission": {"period": 0.2, "ratio": 0.1, "share": 0.3},
}


def corrected(plant, effects_at=(), numbers=None):
    """A model with effects `(name, joint, numbers)` and other parameters."""
    effects = {term(name, joint): given for name, joint, given in effects_at}
    return made.corrected(plant, effects, numbers, Scheme(0.0, 1))


def driven_episode(plant):
    t = np.arange(SAMPLES) * plant.timestep_s
    n = len(plant.joints)
    issued = np.stack(
        [2.0 * np.sin(2 * np.pi * (2.0 + i) * t) for i in range(len(plant.layout.commands))], axis=1
    )
    seen = np.zeros((SAMPLES, 2 * n))
    return Episode(t, issued, seen, plant.layout, Role.TEST, {}, 0, "driven")


def rolled(model):
    """Positions by the corrected model."""
    episode = driven_episode(model.plant)
    windows = cut(model.plant, episode, np.array([0]))
    return model.rollout(windows)[0, :, : len(model.plant.joints)]


def simulated(folder, text, plant):
    """Positions by MuJoCo."""
    spec = mujoco.MjSpec.from_string(text)
    spec.modelfiledir = str(folder)
    model = spec.compile()
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    model.opt.timestep = plant.timestep_s
    data = mujoco.MjData(model)
    data.qpos[:] = 0.0
    driven = [model.joint(model.actuator(i).trnid[0]).name for i in range(model.nu)]
    columns = {plant.joints[j]: int(c) for j, c in enumerate(plant.command_columns)}
    shown = [model.joint(name).qposadr[0] for name in plant.joints]
    issued, seen = driven_episode(plant).commands, []
    for i in range(SAMPLES):
        seen.append(data.qpos[shown])
        data.ctrl[:] = [issued[i, columns[name.removeprefix("motor of ")]] for name in driven]
        mujoco.mj_step(model, data)
    return np.array(seen)


def agreed(folder, plant, name, model):
    """How far MuJoCo's motion under the written file is from the corrected model's, as a part of
    what the correction changes."""
    written = write(folder / name, patch(model), ["a heading"])
    found, wanted, nominal = (
        simulated(folder, written.text, plant),
        rolled(model),
        rolled(corrected(plant)),
    )
    return float(np.linalg.norm(found - wanted) / np.linalg.norm(nominal - wanted)), written


@pytest.mark.parametrize("effect", sorted(NATIVE))
def test_mujoco_moves_as_the_corrected_model_does(tmp_path, effect):
    plant = plant_of(tmp_path, ARM, ["shoulder", "elbow"], period_s=0.002)
    model = corrected(plant, [(effect, 1, NATIVE[effect])])
    off, written = agreed(tmp_path, plant, "robot.xml", model)
    assert off < EXPRESSED
    assert written.left == ()


def test_friction_near_rest_is_nearer_by_bristles_than_without(tmp_path):
    plant = plant_of(tmp_path, ARM, ["shoulder", "elbow"], period_s=0.002)
    law = {"level": 0.4, "extra": 0.8, "speed": 1.0, "sharpness": 1.0}
    model = corrected(plant, [("stribeck_friction", 1, law)])
    off, written = agreed(tmp_path, plant, "robot.xml", model)
    assert off < 0.1
    without = simulated(tmp_path, re.sub("<dcmotor[^>]*/>", "", written.text), plant)
    nominal, wanted = rolled(corrected(plant)), rolled(model)
    assert np.linalg.norm(without - wanted) > 4.0 * off * np.linalg.norm(nominal - wanted)
    assert [x.effect for x in written.left] == ["stribeck_friction"]


def test_a_servos_goal_changes_no_faster_than_its_limit(tmp_path):
    text = ARM.replace("motor", 'position kp="30" kv="0.4"')
    plant = plant_of(tmp_path, text, ["shoulder", "elbow"])
    off, written = agreed(
        tmp_path, plant, "robot.xml", corrected(plant, [("rate_limit", 1, {"rate": 9.0})])
    )
    assert off < EXPRESSED
    assert written.left == ()
    assert "<dcmotor" in written.text
    both = [("rate_limit", 1, {"rate": 9.0}), ("actuator_lag", 1, {"time_constant": 0.05})]
    assert [x.effect for x in patch(corrected(plant, both)).left] == ["rate_limit"]


def test_a_motor_takes_its_inertia_from_the_armature_or_not_at_all(tmp_path):
    plant = plant_of(tmp_path, ARM, ["shoulder", "elbow"])
    law = {"period": 0.2, "ratio": 0.1, "share": 0.8}
    assert [x.effect for x in patch(corrected(plant, [("elastic_transmission", 1, law)])).left] == [
        "elastic_transmission"
    ]


def test_a_servo_saturates_in_its_error_and_is_written_as_a_force_range(tmp_path):
    servos = ARM.replace('<motor joint="shoulder"/>', '<position joint="shoulder" kp="40"/>')
    plant = plant_of(
        tmp_path,
        servos.replace('<motor joint="elbow"/>', '<position joint="elbow" kp="15"/>'),
        ["shoulder", "elbow"],
    )
    model = corrected(plant, [("saturation", 1, {"limit": 0.2})])
    off, written = agreed(tmp_path, plant, "robot.xml", model)
    assert off < EXPRESSED
    assert written.left == ()
    change = next(c for c in patch(model).changes if c.attribute == "forcerange")
    assert (change.joint, change.corrected) == ("elbow", [-3.0, 3.0])


def test_what_a_servos_drive_does_depends_on_its_error_alone(tmp_path):
    """Goal and position moved together: a deadband, a saturation, the friction of a gear or a
    spring behind it does not notice."""
    text = ARM.replace('gravity="0 0 -9.81"', 'gravity="0 0 0"').replace(
        "motor", 'position kp="30"'
    )
    plant = plant_of(tmp_path, text, ["shoulder", "elbow"])
    laws = {
        "saturation": {"limit": 0.3},
        "deadband": {"width": 0.1},
        "gain_asymmetry": {"asymmetry": 0.3},
        "quadratic_gain": {"odd": 5.0},
    }
    laws |= {
        "load_dependent_friction": {"coefficient": 0.8},
        "elastic_transmission": {"period": 0.2, "ratio": 0.1, "share": 0.3},
    }
    at_rest = np.zeros((SAMPLES, 4))
    t = np.arange(SAMPLES) * plant.timestep_s
    waves = np.sin(2 * np.pi * np.stack([2.0 * t, 3.0 * t], axis=1))
    for name, numbers in laws.items():
        model, found = corrected(plant, [(name, 0, numbers)]), []
        for turned in (
            0.0,
            1.5,
        ):  # of the shoulder: without gravity, no pose of the first joint differs from another
            goals, seen = (
                waves + np.array([turned, 0.0]),
                at_rest + np.array([turned, 0.0, 0.0, 0.0]),
            )
            episode = Episode(t, goals, seen, plant.layout, Role.TEST, {}, 0, f"turned by {turned}")
            found.append(
                model.rollout(cut(plant, episode, np.array([0])))[0, :, :2] - [turned, 0.0]
            )
        np.testing.assert_allclose(found[0], found[1], atol=1e-9)
        assert np.abs(found[0] - rolled_from_rest(corrected(plant), t, waves)).max() > 0.01, name


def rolled_from_rest(model, t, goals):
    episode = Episode(
        t, goals, np.zeros((len(t), 4)), model.plant.layout, Role.TEST, {}, 0, "from rest"
    )
    return model.rollout(cut(model.plant, episode, np.array([0])))[0, :, :2]


def test_every_number_of_every_kind_of_joint_goes_into_the_file(tmp_path):
    """Branches, slides, welded bodies, servos, several joints of one body; masses, armatures,
    dampings, springs, gains."""
    plant = plant_of(tmp_path, EVERYTHING, ["a", "b", "c"])
    rng, joints = np.random.default_rng(3), len(plant.joints)
    numbers = np.array(plant.parameters)
    numbers[LINK * joints :] *= rng.uniform(0.8, 1.2, len(numbers) - LINK * joints)
    for j in range(joints):
        numbers[LINK * j : LINK * (j + 1)] *= rng.uniform(0.9, 1.1)
    off, written = agreed(tmp_path, plant, "robot.xml", corrected(plant, numbers=numbers))
    assert off < 1e-5
    assert written.left == ()


def test_links_that_cannot_exist_become_the_nearest_that_move_alike(tmp_path):
    plant = plant_of(tmp_path, ARM, ["shoulder", "elbow"])
    assert isinstance(plant.dynamics, CompiledTree)
    numbers = np.array(plant.parameters)
    numbers[0] = -0.3  # the first link turns about a fixed axis: its mass moves nothing
    numbers[LINK + 4] = -0.1
    model = corrected(plant, numbers=numbers)
    made, off = feasible(
        type(plant.dynamics.tree)(plant.joints, plant.dynamics.tree.constants, tuple(numbers))
    )
    assert off < 1e-6
    assert made.parameters[0] > 0.0
    q, v, a = np.random.default_rng(0).normal(size=(3, 20, 2))
    np.testing.assert_allclose(
        inverse_dynamics(made, q, v, a),
        inverse_dynamics(type(made)(made.joints, made.constants, tuple(numbers)), q, v, a),
        atol=1e-5,
    )
    written = write(tmp_path / "robot.xml", patch(model), [])
    mujoco.MjModel.from_xml_string(written.text)
    assert written.left == ()


def test_masses_that_no_bodies_have_are_said(tmp_path):
    plant = plant_of(tmp_path, ARM, ["shoulder", "elbow"])
    numbers = np.array(plant.parameters)
    numbers[LINK : 2 * LINK] *= -0.5
    written = write(tmp_path / "robot.xml", patch(corrected(plant, numbers=numbers)), [])
    mujoco.MjModel.from_xml_string(written.text)
    assert any("no bodies have the masses" in x.instead for x in written.left)


def test_what_mjcf_cannot_express_says_what_to_write_instead(tmp_path):
    plant = plant_of(tmp_path, ARM, ["shoulder", "elbow"])
    for name, effect in effects().items():
        made = patch(
            corrected(
                plant,
                [(name, 1, NATIVE.get(name) or {n.name: max(n.low, 0.1) for n in effect.params})],
            )
        )
        whole = name in NATIVE or name == "sensor_delay"
        assert bool(made.left) != whole, name
        assert all(x.joint == "elbow" and x.instead == effects()[name].in_mjcf for x in made.left)
        assert made.changes or made.left


def test_an_undriven_joint_has_no_actuator_to_push_with(tmp_path):
    plant = plant_of(tmp_path, ARM.replace('<motor joint="elbow"/>', ""), ["shoulder"])
    made = patch(corrected(plant, [("constant_force", 1, {"level": 1.0})]))
    assert [x.effect for x in made.left] == ["constant_force"]
    assert made.changes == ()


def test_the_difference_is_the_correction_and_nothing_else(tmp_path):
    text = ARM.replace("<body name", "\n  <!-- kept -->\n  <body name").replace(
        "<actuator>", "\n<actuator>\n"
    )
    plant = plant_of(tmp_path, text, ["shoulder", "elbow"])
    written = write(
        tmp_path / "robot.xml",
        patch(corrected(plant, [("coulomb_friction", 0, {"level": 0.5})])),
        ["from here"],
    )
    lines = [
        x for x in written.difference.splitlines() if x[0] in "+-" and x[:3] not in ("+++", "---")
    ]
    assert len(lines) == 2 + 3  # a joint's line before and after; a comment of three
    assert "kept" in written.text
    assert tags(written.text)[0].name == "mujoco"
    (tmp_path / "corrected.patch").write_text(written.difference)
    subprocess.run(["git", "init", "-q"], cwd=tmp_path, check=True)
    subprocess.run(["git", "apply", "corrected.patch"], cwd=tmp_path, check=True)
    assert (tmp_path / "robot.xml").read_text() == written.text


def test_a_late_sensor_is_a_sensor_with_a_delay(tmp_path):
    plant = plant_of(tmp_path, ARM, ["shoulder", "elbow"])
    written = write(
        tmp_path / "robot.xml", patch(corrected(plant, [("sensor_delay", 1, {"delay": 0.012})])), []
    )
    model = mujoco.MjModel.from_xml_string(written.text)
    data = mujoco.MjData(model)
    data.qvel[:] = 1.0
    past = []
    for _ in range(20):
        mujoco.mj_step(model, data)
        past.append(data.qpos[1])
    late = round(0.012 / model.opt.timestep)
    mujoco.mj_forward(model, data)
    assert data.sensordata[0] == pytest.approx(past[-1 - late], abs=1e-9)


def test_a_stop_is_a_spring_with_room(tmp_path):
    plant = plant_of(tmp_path, ARM, ["shoulder", "elbow"])
    stop = {"limit": 0.4, "stiffness": 900.0, "damping": 0.0, "centre": 0.05, "rebound": 1.0}
    off, written = agreed(tmp_path, plant, "robot.xml", corrected(plant, [("hard_stop", 0, stop)]))
    assert off < EXPRESSED
    assert [x.effect for x in written.left] == ["hard_stop"]


@pytest.mark.parametrize("made", ["urdf", "included"])
def test_a_model_of_several_files_is_written_whole(tmp_path, made):
    if made == "urdf":
        name, text, joints = "robot.urdf", URDF, ["first", "second"]
    else:
        name, joints = "robot.xml", ["shoulder", "elbow"]
        (tmp_path / "bodies.xml").write_text(
            f"<mujoco>{ARM[ARM.index('<worldbody>') : ARM.index('<actuator>')]}</mujoco>"
        )
        text = f'<mujoco model="arm"><include file="bodies.xml"/>{ARM[ARM.index("<actuator>") :]}'
    plant = plant_of(tmp_path, text, joints, name=name)
    written = write(
        Path(tmp_path / name),
        patch(corrected(plant, [("coulomb_friction", 0, {"level": 0.5})])),
        ["from here"],
    )
    assert written.difference == ""
    model = mujoco.MjModel.from_xml_string(written.text)
    assert isinstance(plant.dynamics, CompiledTree)
    assert model.dof_frictionloss[0] == pytest.approx(0.5 * plant.dynamics.form.sizes[0])


def test_ports_that_have_no_element_are_all_described():
    described = {e.name for e in effects().values() if e.in_mjcf != Effect.in_mjcf}
    assert described | set(NATIVE) | {"sensor_delay"} == set(effects())
    assert all(effect.port in Port for effect in effects().values())


def test_masses_that_no_bodies_have_become_ones_that_some_have(tmp_path):
    """Both links lighter than nothing: whatever is nearest, MuJoCo takes it, and how far off its
    forces are is said."""
    plant = plant_of(tmp_path, ARM, ["shoulder", "elbow"])
    numbers = np.array(plant.parameters)
    numbers[: 2 * LINK] *= -1.0
    written = write(tmp_path / "robot.xml", patch(corrected(plant, numbers=numbers)), ["a heading"])
    masses = mujoco.MjModel.from_xml_string(written.text).body_mass[1:]
    assert (masses > 0.0).all()
    assert (
        masses < 100.0 * np.array(plant.parameters)[: 2 * LINK : LINK]
    ).all()  # they are not driven away
    assert "no bodies have the masses" in written.left[0].instead
