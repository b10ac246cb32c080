"""One joint as MJCF: MuJoCo moves it as the model does."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from tests.support.made import plant_document
from trueup.model.corrected import Corrected
from trueup.model.mjcf_family import mjcf_of_joint
from trueup.model.plant import Plant
from trueup.model.series import DECLARED, Scheme

SAMPLES, PERIOD_S = 400, 0.01
FORMS = {
    "inertia": {"c": 0.6, "b": 0.8},
    "oscillator": {"k": 3.0, "c": 0.6, "b": 0.8},
    "pendulum": {"k": 9.0, "c": 0.6, "b": -0.8},
}
EFFECTS = {
    "coulomb_friction": {"level": 0.15},
    "quadratic_drag": {"coefficient": 0.9},
    "cubic_stiffness": {"coefficient": 1.1},
    "constant_force": {"level": 0.3},
    "saturation": {"limit": 0.7},
    "actuator_lag": {"time_constant": 0.08},
    "actuator_delay": {"delay": 0.06},
    "rate_limit": {"rate": 0.9},
    "cogging": {"sine": 0.1, "cosine": 0.1, "pitch": 0.3},
    "hysteresis": {"level": 0.2, "distance": 0.1, "shape": 1.0, "sharpness": 0.0},
    "elastic_transmission": {"period": 0.7, "ratio": 0.1, "share": 0.4},
}


def plant_of(family):
    document = plant_document()
    document["nominal"] = {"family": family, "parameters": FORMS[family], "timestep_s": PERIOD_S}
    return Plant.from_document(document)


def model_of(family, effects):
    plant = plant_of(family)
    bare = Corrected.of_numbers(plant, tuple(FORMS[family].values()))
    values, hypothesis = list(bare.values), bare.hypothesis
    for name, numbers in effects.items():
        hypothesis |= name
        for key, row in plant.block.rows_of(name).items():
            values[row] = numbers[key]
    return Corrected(plant, hypothesis, tuple(values), Scheme(0.5, 4))


def moved(text, issued, start):
    engine = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(engine)
    data.qpos[:], data.qvel[:] = start  # a motor of its own begins with the joint
    mujoco.mj_forward(engine, data)
    found = []
    for u in issued:
        found.append(data.qpos[0])
        data.ctrl[0] = u
        for _ in range(round(PERIOD_S / engine.opt.timestep)):
            mujoco.mj_step(engine, data)
    return np.array(found)


@pytest.mark.parametrize(
    ("family", "effect"),
    [
        *((f, None) for f in FORMS),
        *(("oscillator", e) for e in EFFECTS),
        ("pendulum", "coulomb_friction"),
    ],
)
def test_mujoco_moves_as_the_model_does(family, effect, tmp_path):
    chosen = {} if effect is None else {effect: EFFECTS[effect]}
    model, start = model_of(family, chosen), (0.2, 0.1)
    issued = 1.3 * np.sin(2.1 * np.arange(SAMPLES) * PERIOD_S)[:, None]
    written = mjcf_of_joint(model, tmp_path, ["by hand"])
    assert written.left == ()
    ours = model.run(np.array(start), issued)[:, 0]
    off = np.abs(moved(written.text, issued[:, 0], start) - ours).max()
    without = model_of(family, {}).run(np.array(start), issued)[:, 0]
    assert off < 0.01 * np.ptp(ours)
    assert effect is None or off < 0.1 * np.abs(without - ours).max()


@pytest.mark.parametrize("family", FORMS)
def test_the_declared_step_is_mujocos_own(family, tmp_path):
    model, start = replace(model_of(family, {}), scheme=DECLARED), (0.2, 0.1)
    issued = 1.3 * np.sin(2.1 * np.arange(SAMPLES) * PERIOD_S)[:, None]
    ours = model.run(np.array(start), issued)[:, 0]
    assert (
        np.abs(
            moved(mjcf_of_joint(model, tmp_path, ["by hand"]).text, issued[:, 0], start) - ours
        ).max()
        < 1e-12
    )


def test_what_mujoco_has_no_element_for_is_said(tmp_path):
    model = model_of("inertia", {"backlash": {"gap": 0.1}, "coulomb_friction": {"level": 0.1}})
    written = mjcf_of_joint(model, tmp_path, ["by hand"])
    assert [(x.effect, x.joint) for x in written.left] == [("backlash", "joint")]
    assert "not expressed: backlash" in written.text
    assert 'frictionloss="0.1"' in written.text
