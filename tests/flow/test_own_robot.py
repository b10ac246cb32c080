"""A simulator of one's own with two joints, from tables to a verdict and a file of actuators."""

import numpy as np
import pytest

import trueup
from trueup.errors import NotExportable

STEP_S, SAMPLES, LATE = 0.02, 200, 3
TRUTH = {"gain_pan": 30.0, "gain_tilt": 24.0, "spring": 33.0, "damping": 2.0}
DECLARED = TRUTH | {"spring": 30.0}


def step(state, command, parameters):
    """A camera on two springs; what tilts it also turns it a little."""
    q, v = state[:, :2], state[:, 2:]
    p = parameters
    driven = command * np.stack([p["gain_pan"], p["gain_tilt"]], axis=1)
    a = driven - p["spring"][:, None] * q - p["damping"][:, None] * v
    v = v + STEP_S * (a + 0.2 * a[:, ::-1])
    return np.concatenate([q + STEP_S * v, v], axis=1)


def run(seed):
    """What the camera does with a tilt drive that is `LATE` steps late."""
    rng = np.random.default_rng(seed)
    u = np.stack(
        [
            np.clip(np.convolve(rng.normal(size=SAMPLES), np.ones(12) / 5.0, "same"), -1.0, 1.0)
            for _ in range(2)
        ],
        axis=1,
    )
    lanes = {name: np.array([value]) for name, value in TRUTH.items()}
    states = np.zeros((SAMPLES, 4))
    for i in range(SAMPLES - 1):
        commands = np.array([[u[i, 0], u[max(i - LATE, 0), 1]]])
        states[i + 1] = step(states[i : i + 1], commands, lanes)
    states += rng.normal(scale=1e-4, size=states.shape)
    columns = {"t_s": STEP_S * np.arange(SAMPLES)}
    for j, joint in enumerate(("pan", "tilt")):
        columns |= {
            f"{joint}_pos_rad": states[:, j],
            f"{joint}_vel_rad_s": states[:, 2 + j],
            f"{joint}_cmd_nm": u[:, j],
        }
    return columns


@pytest.fixture(scope="module")
def answer():
    camera = trueup.Simulator(step, DECLARED, joints=("pan", "tilt"), timestep_s=STEP_S)
    case = trueup.Case.from_table([run(seed) for seed in range(3)], plant=camera, stage="SIL")
    return trueup.diagnose(case)


def test_the_effect_is_found_at_its_joint(answer):
    assert [(e.effect, e.joint) for e in answer.effects] == [("actuator_delay", "tilt")]
    assert answer.effects[0].estimates["delay"].value == pytest.approx(LATE * STEP_S, abs=1e-3)
    assert answer.parameters["spring"].value == pytest.approx(TRUTH["spring"], rel=0.01)
    assert answer.gap.closed > 0.9


def test_its_model_predicts_both_joints_and_leaves_as_actuators(answer, tmp_path):
    rolled = answer.model.rollout({}, np.ones((20, 2)))
    assert rolled.shape == (20, 4)
    assert abs(rolled[1, 0]) > 0.0
    answer.export(tmp_path / "actuators.py", "isaaclab", step_s=0.005)
    text = (tmp_path / "actuators.py").read_text()
    assert "max_delay=12" in text
    said = " ".join(text.split())
    assert "must hold the joints' inertias at rest and what gravity" in said
    assert "multiply each joint's by its own" in said
    with pytest.raises(NotExportable, match="several joints"):
        answer.export(tmp_path / "other.py", "isaaclab", inertia=0.1)
    with pytest.raises(NotExportable, match="has no MJCF"):
        answer.export(tmp_path / "camera.xml")
