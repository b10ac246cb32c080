"""A robot's case folder, from the command to a model that MuJoCo loads; and a real arm's
recording."""

import json
import subprocess
import sys
from pathlib import Path

import mujoco
import numpy as np

from tests.support.case import write_recordings
from tests.support.robots import arm_plant, recorded
from trueup.diagnose.case import read_case
from trueup.episode.role import Role
from trueup.fit.identify import identify
from trueup.fit.score import rollout_rms
from trueup.model.predictor import Nominal

SO101 = Path(__file__).parents[2] / "examples" / "so101"
HALF_A_SECOND = 125  # samples


def differs(spec):
    """A payload, and friction that the model does not know."""
    spec.body("lower").add_geom(
        type=2, size=[0.03, 0, 0], pos=[0.3, 0, 0], mass=0.4, contype=0, conaffinity=0
    )
    spec.joint("elbow").frictionloss = 0.25


def missed(path, episodes):
    """RMS error of MuJoCo's positions half a second after each state that was seen [rad]."""
    model = mujoco.MjModel.from_xml_path(str(path))
    errors = []
    for e in episodes:
        for first in range(0, len(e.t_s) - HALF_A_SECOND, HALF_A_SECOND):
            data = mujoco.MjData(model)
            data.qpos[:], data.qvel[:] = e.observations[first, :2], e.observations[first, 2:]
            for i in range(first, first + HALF_A_SECOND):
                data.ctrl[:] = e.commands[i]
                mujoco.mj_step(model, data)
            errors.append(data.qpos - e.observations[first + HALF_A_SECOND, :2])
    return float(np.sqrt(np.mean(np.square(errors))))


def test_mujoco_moves_as_the_machine_did_once_the_diagnosis_is_written_into_the_model(tmp_path):
    plant = arm_plant(tmp_path)
    roles = ("adaptation", "adaptation", "validation", "validation")
    write_recordings(tmp_path, recorded(plant, differs, range(4), roles))
    found = tmp_path / "found"
    subprocess.run(
        [sys.executable, "-m", "trueup_cli.main", "diagnose", str(tmp_path), "--out", str(found)],
        check=True,
    )
    report = json.loads((found / "report.json").read_text())
    assert [(e["effect"], e["joint"]) for e in report["effects"]] == [("coulomb_friction", "elbow")]
    held_out = [e for e in read_case(tmp_path)[1] if e.role is Role.VALIDATION]
    before, after = (
        missed(path, held_out) for path in (tmp_path / "arm.xml", found / "corrected.xml")
    )
    assert after < 0.1 * before
    applied = subprocess.run(
        ["patch", "-s", "-o", "-", str(tmp_path / "arm.xml"), str(found / "corrected.patch")],
        capture_output=True,
        text=True,
        check=True,
    )
    assert applied.stdout == (found / "corrected.xml").read_text()


def test_the_numbers_of_a_real_arm_are_found():
    """Six joints, position servos, positions alone on a lattice: rollouts on what was held out miss
    by less than half."""
    plant, episodes = read_case(SO101)
    fitted, report = identify(plant, [e for e in episodes if e.role is Role.ADAPTATION])
    held_out = [e for e in episodes if e.role is Role.VALIDATION]
    assert len(plant.joints) == 6
    before, after = (
        np.mean([rollout_rms(p, e, plant.horizon_s) for e in held_out])
        for p in (Nominal(plant), fitted)
    )
    assert after < 0.5 * before
    assert report.health == ()
