"""A simulator of one's own from a table to a verdict and an actuator's configuration, in a notebook
and on the command line."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest

import trueup
from tests.support.service import ROOT
from trueup.artifact.onnx import to_onnx
from trueup.errors import BadSimulator, NotExportable

EXAMPLE = ROOT / "examples" / "own-simulator" / "pendulum.py"
STEP_S, SAMPLES, LATE = 0.02, 250, 3


def step(state, command, parameters):
    """A joint on a spring, with steps of one length and no force."""
    q, v = state.T
    p = parameters
    v = v + STEP_S * (p["gain"] * command[:, 0] - p["spring"] * q - p["damping"] * v)
    return np.column_stack([q + STEP_S * v, v])


def run(seed):
    """What the joint does with a drive that is `LATE` steps late."""
    rng = np.random.default_rng(seed)
    u = np.clip(np.convolve(rng.normal(size=SAMPLES), np.ones(12) / 5.0, "same"), -1.0, 1.0)
    lanes = {"gain": np.array([30.0]), "spring": np.array([33.0]), "damping": np.array([2.0])}
    states = np.zeros((SAMPLES, 2))
    for i in range(SAMPLES - 1):
        late = u[max(i - LATE, 0)]
        states[i + 1] = step(states[i : i + 1], np.array([[late]]), lanes)
    states += rng.normal(scale=1e-4, size=states.shape)
    return {"t_s": STEP_S * np.arange(SAMPLES), "q_rad": states[:, 0], "v_rad_s": states[:, 1],
            "u_nm": u}  # fmt: skip


@pytest.fixture(scope="module")
def answered():
    simulator = trueup.Simulator(
        step, {"gain": 30.0, "spring": 30.0, "damping": 2.0}, timestep_s=STEP_S
    )
    case = trueup.Case.from_table([run(seed) for seed in range(3)], plant=simulator, stage="SIL")
    return case, trueup.diagnose(case)


def test_the_effect_is_found_and_what_could_not_be_tried_is_told(answered):
    _, answer = answered
    assert [e.effect for e in answer.effects] == ["actuator_delay"]
    late = answer.effects[0].estimates["delay"]
    assert late.value == pytest.approx(LATE * STEP_S, abs=1e-3)
    assert answer.parameters["spring"].value == pytest.approx(33.0, rel=0.01)
    assert any("takes no force" in warning for warning in answer.warnings)
    assert answer.gap.closed > 0.95


def test_it_leaves_with_an_actuators_configuration(answered, tmp_path):
    _, answer = answered
    answer.export(tmp_path / "actuators.py", "isaaclab", step_s=0.005)
    text = (tmp_path / "actuators.py").read_text()
    assert "DelayedPDActuatorCfg" in text
    assert "max_delay=12" in text


def test_its_model_is_saved_and_loaded_where_the_simulator_is_at_hand(answered, tmp_path):
    _, answer = answered
    answer.save(tmp_path)
    loaded = trueup.load(tmp_path / "model")
    assert loaded.digest == answer.model.digest
    rolled = loaded.rollout({"q": 0.1}, np.ones((20, 1)))
    assert rolled.shape == (20, 2)
    load = f"import trueup; trueup.load({str(tmp_path / 'model')!r})"
    refused = subprocess.run(
        [sys.executable, "-c", load], capture_output=True, text=True, check=False
    )
    assert refused.returncode == 1
    assert "needs the simulator step" in refused.stderr


def test_it_has_no_form_in_onnx_and_says_so(answered):
    _, answer = answered
    with pytest.raises(NotExportable, match="simulator of your own"):
        to_onnx(answer.model.predictor, answer.model.digest)


def test_a_step_of_one_length_says_which():
    with pytest.raises(BadSimulator, match="nobody said which"):
        trueup.Case.from_table([run(0)], plant=trueup.Simulator(step, {"gain": 30.0}))


def test_the_command_line_takes_a_file_that_plant_json_names(tmp_path):
    nominal = {
        "simulator": EXAMPLE.name,
        "parameters": {"inertia": 0.1, "kt": 0.5, "damping": 0.05, "mgl": 1.0},
        "timestep_s": STEP_S,
    }
    trueup.Case.from_table([run(0), run(1)], stage="SIL").save(tmp_path)
    document = json.loads((tmp_path / "plant.json").read_text())
    (tmp_path / "plant.json").write_text(json.dumps({**document, "nominal": nominal}))
    check = [sys.executable, "-m", "trueup_cli.main", "doctor", str(tmp_path), "--json"]
    alone = subprocess.run(check, capture_output=True, text=True, check=False)
    assert alone.returncode != 0
    assert "TRUEUP_SIMULATORS" in alone.stdout
    environment = {**os.environ, "TRUEUP_SIMULATORS": str(EXAMPLE)}
    named = subprocess.run(check, capture_output=True, text=True, env=environment, check=False)
    assert named.returncode == 0, named.stdout
