"""A corrected model as Isaac Lab, mjlab and ros2_control take it: what they do with it is what the
model predicts, and what is not certain stands beside the numbers."""

import json
from dataclasses import replace

import numpy as np
import onnx
import pytest
import yaml as pyyaml

import trueup
from tests.support import recorded
from tests.support.made import plant_document
from tests.unit.export.simulators import read, rolled
from trueup.errors import NotExportable
from trueup.export.joint_drive import drives_of
from trueup.export.targets import TARGETS, Asked, export
from trueup.model.block import term
from trueup.model.corrected import Corrected
from trueup.model.hypothesis import Hypothesis
from trueup.model.plant import Plant
from trueup.model.predictor import Nominal
from trueup.model.series import refined
from trueup.model.simulator.simulator import offer

# so fine a step that the simulator's own integrator, of first order, is not what is compared
STEP_S, HOLD, PERIOD_S = 0.0001, 20, 0.002
NUMBERS = {"k": 30.0, "c": 2.0, "b": 30.0}
LEAST = 0.01  # of what the correction changes: more is a difference
CASES = {
    "friction of a servo": ("position", {"coulomb_friction": {"level": 3.0}}),
    "friction of a motor": ("effort", {"coulomb_friction": {"level": 3.0}}),
    "delay of a servo": ("position", {"actuator_delay": {"delay": 0.02}}),
    "delay of a motor": ("effort", {"actuator_delay": {"delay": 0.02}}),
    "limit of a motor": ("effort", {"saturation": {"limit": 0.4}}),
    "constant force": ("effort", {"constant_force": {"level": 2.0}}),
    "friction and delay": (
        "effort",
        {"coulomb_friction": {"level": 2.0}, "actuator_delay": {"delay": 0.01}},
    ),
}


def plant(field, family="oscillator"):
    document = plant_document("arm")
    given = NUMBERS if family != "inertia" else {n: NUMBERS[n] for n in ("c", "b")}
    document["nominal"] = {"family": family, "parameters": given, "timestep_s": PERIOD_S}
    document["commands"] = [
        {"name": "u", "unit": "rad", "joint": "elbow", "field": field, "limits": [-1.0, 1.0]}
    ]
    document["observations"] = [{"name": "q", "unit": "rad", "joint": "elbow"}]
    del document["envelope"]
    return Plant.from_document(document)


def corrected(of, numbers):
    """The nominal model with some effects."""
    hypothesis = Hypothesis(tuple(term(name, 0) for name in numbers))
    values = of.block.nulls.copy()
    values[: len(of.parameters)] = of.parameters
    for name, given in numbers.items():
        for number, row in of.block.rows_of(term(name, 0)).items():
            values[row] = given[number]
    return Corrected(of, hypothesis, tuple(map(float, values)), refined(of))


def commands(samples=2000):
    rng = np.random.default_rng(5)
    return np.clip(np.convolve(rng.normal(size=samples), np.ones(100) / 18, "same"), -0.9, 0.9)


def asked(model, **more):
    return Asked(model, "0" * 64, "0", **{"step_s": STEP_S} | more)


@pytest.mark.parametrize("target", ["isaaclab", "mjlab"])
@pytest.mark.parametrize("name", CASES)
def test_the_simulator_does_what_the_model_predicts(name, target, tmp_path, monkeypatch):
    field, numbers = CASES[name]
    of = plant(field)
    model = corrected(of, numbers)
    export(asked(model), target, tmp_path / "arm.py")
    actuators, actions, _ = read((tmp_path / "arm.py").read_text(), target, monkeypatch)
    drive = drives_of(model, "").drives[0]
    issued = commands()
    simulated = rolled(
        actuators["elbow"], actions["elbow"], issued, step_s=STEP_S, hold=HOLD,
        spring=drive["spring"].value,
    )  # fmt: skip
    predicted, nominal = (
        of.observe(m.run(np.zeros(2), np.append(issued, 0.0)[:, None]))[1:, 0]
        for m in (model, Nominal(of))
    )
    changed = np.sqrt(np.mean((predicted - nominal) ** 2))
    difference = np.sqrt(np.mean((simulated - predicted) ** 2))
    assert difference < LEAST * changed, f"{difference / changed:.3%} of what is corrected"


@pytest.fixture(scope="module")
def answer():
    tables = [
        {"time_s": r.t_s, "q_rad": r.q, "v_rad_s": r.v, "u_nm": r.u}
        for r in (recorded.simulated(1000, seed) for seed in range(3))
    ]
    return trueup.diagnose(
        trueup.Case.from_table(tables, plant=trueup.Oscillator(k=9.0, c=2.0, b=8.0, name="arm"))
    )


def test_intervals_stand_beside_the_numbers_and_are_drawn_from(answer, tmp_path, monkeypatch):
    answer.export(tmp_path / "arm.py", "isaaclab", inertia=0.5)
    text = (tmp_path / "arm.py").read_text()
    actuators, _, events = read(text, "isaaclab", monkeypatch)
    level = answer.effects[0].estimates["level"]
    (config,) = actuators.values()
    assert config["friction"] == pytest.approx(0.5 * level.value, rel=1e-4)
    drawn = events["joint_joint"]["params"]["friction_distribution_params"]
    np.testing.assert_allclose(drawn, 0.5 * np.array(level.ci95), rtol=1e-3)
    assert answer.sentence.split(";")[0][:40] in " ".join(text.split())
    assert "inertia of 0.5" in text
    assert "95 %:" in text


def test_what_cannot_be_told_apart_is_told(answer, tmp_path):
    report = json.loads(json.dumps(answer.report)) | {"indistinguishable": [["stribeck_friction"]]}
    export(asked(answer.engine.predictor, report=report), "isaaclab", tmp_path / "arm.py")
    assert "cannot tell this from: Stribeck friction" in (tmp_path / "arm.py").read_text()


def test_formats_of_other_runtimes_hold_the_intervals_too(answer, tmp_path):
    level = answer.effects[0].estimates["level"]
    answer.export(tmp_path / "arm.onnx")
    metadata = onnx.load(tmp_path / "arm.onnx").metadata_props
    known = json.loads({p.key: p.value for p in metadata}["diagnosis"])
    assert known["answer"] == answer.sentence
    by_name = {x["name"]: x for x in known["intervals"]}
    assert by_name["coulomb_friction, level"]["ci95"] == list(level.ci95)
    answer.export(tmp_path / "arm.xml")
    text = (tmp_path / "arm.xml").read_text()
    assert f"coulomb_friction, level: {level.value:.6g}" in text
    assert f"95 % interval {level.ci95[0]:.6g} to {level.ci95[1]:.6g}" in text


def test_yaml_holds_the_same_numbers(answer, tmp_path):
    answer.export(tmp_path / "arm.yaml", "isaaclab")
    document = pyyaml.safe_load((tmp_path / "arm.yaml").read_text())
    (config,) = document["actuators"].values()
    assert config["friction"] == pytest.approx(answer.effects[0].estimates["level"].value, rel=1e-4)
    (ranges,) = document["randomisation"].values()
    assert ranges["friction"][0] < config["friction"] < ranges["friction"][1]


def test_ros2_control_gets_a_proposal_that_says_so(answer, tmp_path):
    answer.export(tmp_path / "arm.yaml", "ros2_control")
    text = (tmp_path / "arm.yaml").read_text()
    assert text.startswith("# A proposal")
    node = pyyaml.safe_load(text)["compensation_controller"]["ros__parameters"]
    joint = node[node["joints"][0]]
    assert joint["friction_feedforward"]["coulomb"] == pytest.approx(0.6, rel=0.05)
    assert joint["command_scale"]["per_force"] == pytest.approx(1 / 8.0, rel=0.02)


def test_ranges_are_the_ones_that_train(answer, tmp_path):
    answer.export(tmp_path / "ranges.json", "randomisation")
    document = json.loads((tmp_path / "ranges.json").read_text())
    assert {"number": "coulomb_friction.level", "distribution": "uniform"}.items() <= (
        document["numbers"][-1].items()
    )


def test_what_no_drive_holds_is_listed(tmp_path):
    model = corrected(
        plant("effort"), {"backlash": {"gap": 0.1}, "actuator_lag": {"time_constant": 0.05}}
    )
    left = export(asked(model), "isaaclab", tmp_path / "arm.py")
    assert {x.effect for x in left} == {"backlash", "actuator_lag"}
    text = " ".join((tmp_path / "arm.py").read_text().split())
    assert "Not expressed: backlash at elbow" in text
    assert "filter the command" in text


def test_a_delay_becomes_the_steps_that_its_interval_holds():
    from trueup.export.configuration import delay_steps
    from trueup.export.joint_drive import Ranged

    assert delay_steps(Ranged(0.02, 0.0178, 0.0223), 0.005) == (4, 4)
    assert delay_steps(Ranged(0.02, 0.014, 0.026), 0.005) == (3, 5)
    assert delay_steps(Ranged(0.0, 0.0, 0.0), 0.005) == (0, 0)


@pytest.mark.parametrize("target", TARGETS)
def test_another_suffix_is_refused_with_those_that_fit(target, tmp_path):
    with pytest.raises(NotExportable) as refused:
        export(asked(corrected(plant("effort"), {})), target, tmp_path / "arm.txt")
    assert TARGETS[target][0][0] in refused.value.hint


def test_a_robot_keeps_its_own_inertia(tmp_path):
    from tests.support.robots import ARM
    from trueup.model.nominal_form import resolved

    (tmp_path / "arm.xml").write_text(ARM)
    joints = ("shoulder", "elbow")
    document = {
        "name": "arm",
        "nominal": {"mjcf": "arm.xml", "timestep_s": 0.004},
        "commands": [
            {"name": f"u_{j}", "unit": "N·m", "joint": j, "limits": [-5.0, 5.0]} for j in joints
        ],
        "observations": [
            {"name": f"q_{j}", "unit": "rad", "joint": j, "field": "position"} for j in joints
        ],
        "evaluation": {"horizon_s": 0.5},
    }
    of = Plant.from_document(resolved(document, tmp_path))
    drives = drives_of(Nominal(of), "").drives
    assert [(d.joint, d["damping"].value, d["armature"].value) for d in drives] == [
        ("shoulder", 0.3, 0.02),
        ("elbow", 0.2, 0.03),
    ]
    with pytest.raises(NotExportable, match="inertias are those of its model"):
        drives_of(Nominal(of), "", inertia=2.0)


@pytest.mark.parametrize("inertia", [0.02, 0.04])
def test_a_simulators_forces_are_those_of_the_inertia_that_was_found(inertia):
    def step(state, command, parameters, force, h_s):
        q, v = state.T
        p = parameters
        torque = p["kt"] * command[:, 0] + force[:, 0] - p["d"] * v
        v = v + h_s * torque / p["inertia"]
        return np.column_stack([q + h_s * v, v])

    declared = {"d": 0.01, "inertia": inertia, "kt": 0.12}
    document = plant_document("arm") | {
        "nominal": {
            "simulator": "step",
            "sha256": offer(step),
            "parameters": declared,
            "timestep_s": 0.001,
        },
    }
    of = Plant.from_document(document)
    level = 0.06 / float(of.form.sizes[0])  # 0.06 N·m
    model = corrected(of, {"coulomb_friction": {"level": level}})
    values = list(model.values)
    values[:3] = 0.012, 0.02, 0.11  # d, inertia and kt as they were found
    drives = drives_of(replace(model, values=tuple(values)), "0" * 64)
    (drive,) = drives.drives
    found = [drive[name].value for name in ("gain", "damping", "friction")]
    assert found == pytest.approx([0.11, 0.012, 0.06], rel=2e-3)
    assert "inertia of 0.02" in drives.beside


def test_a_simulators_spring_is_not_the_drives():
    def step(state, command, parameters, h_s):
        q, v = state.T
        p = parameters
        servo = p["kp"] * (command[:, 0] - q) - p["kd"] * v
        v = v + h_s * (servo - p["spring"] * q)
        return np.column_stack([q + h_s * v, v])

    document = plant("position").document | {
        "nominal": {
            "simulator": "step",
            "sha256": offer(step),
            "parameters": {"kp": 30.0, "kd": 2.0, "spring": 8.0},
            "timestep_s": 0.001,
        },
    }
    (drive,) = drives_of(Nominal(Plant.from_document(document)), "0" * 64).drives
    found = [drive[name].value for name in ("servo", "damping", "spring")]
    assert found == pytest.approx([30.0, 2.0, 0.0], rel=2e-3)
