"""A robot's case folder, from the command to a model that MuJoCo loads; and a real arm's
recording."""

import json
import subprocess
import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest

from tests.support.case import write_recordings
from tests.support.robots import arm_plant, recorded
from trueup.artifact.model import load
from trueup.diagnose.case import read_case
from trueup.diagnose.summary_text import sentence
from trueup.episode.role import Role
from trueup.fit.base_parameters import directions
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


@pytest.fixture(scope="module")
def case(tmp_path_factory):
    """A case folder, where the command wrote its diagnosis, and the report."""
    folder = tmp_path_factory.mktemp("arm")
    plant = arm_plant(folder)
    roles = ("adaptation", "adaptation", "validation")
    write_recordings(folder, recorded(plant, differs, range(3), roles))
    out = folder / "out"
    subprocess.run(
        [sys.executable, "-m", "trueup_cli.main", "diagnose", str(folder), "--out", str(out)],
        check=True,
    )
    return folder, out, json.loads((out / "report.json").read_text())


def test_the_effect_and_its_joint_are_named(case):
    _, out, report = case
    json.dumps(report, allow_nan=False)
    assert report["verdict"] == "effect"
    assert [(e["effect"], e["joint"]) for e in report["effects"]] == [("coulomb_friction", "elbow")]
    level = report["effects"][0]["estimate"]["level"]
    assert level["unit"] == "N·m"
    assert level["value"] == pytest.approx(0.25, rel=0.05)
    assert all("joint" in bound for bound in report["excluded"])
    assert "coulomb friction at elbow" in sentence(report).lower()
    assert "elbow" in (out / "report.html").read_text()


def test_the_gap_lies_where_the_joint_is_and_not_where_it_travels(case):
    where = case[2]["where"]
    shares = {entry["joint"]: entry for entry in where["joints"]}
    assert shares["elbow"]["force"] > 0.8
    assert shares["elbow"]["force"] > shares["elbow"]["acceleration"]
    assert where["regions_of"] == "elbow"


def test_the_gap_closes_on_held_out_episodes(case):
    gap = case[2]["gap"]
    assert gap["closed"] > 0.95
    assert gap["after"] < 0.2 * gap["before"]


def test_what_the_motion_cannot_show_is_not_numbered(case):
    folder, _, report = case
    plant, episodes = read_case(folder)
    shown = directions(plant, [e for e in episodes if e.role is Role.ADAPTATION])
    determined = {
        n for n, d in zip(plant.dynamics.parameter_names, shown.determined, strict=True) if d
    }
    assert "damping(elbow)" in determined
    assert not determined & {"mass(shoulder)", "Ixx(shoulder)", "Ixy(lower)", "gain(shoulder)"}
    assert set(report["parameters"]) == determined


def test_the_corrected_model_predicts_what_was_held_out(case):
    folder, out, _ = case
    plant, episodes = read_case(folder)
    corrected = load(out / "model").predictor
    held_out = episodes[-1]
    after, before = (
        np.linalg.norm(rollout_rms(p, held_out, plant.horizon_s))
        for p in (corrected, Nominal(plant))
    )
    assert after < 0.1 * before


def test_mujoco_moves_as_the_machine_did_once_the_diagnosis_is_written_into_the_model(case):
    folder, out, _ = case
    held_out = [e for e in read_case(folder)[1] if e.role is Role.VALIDATION]
    before, after = (missed(path, held_out) for path in (folder / "arm.xml", out / "corrected.xml"))
    assert after < 0.1 * before
    applied = subprocess.run(
        ["patch", "-s", "-o", "-", str(folder / "arm.xml"), str(out / "corrected.patch")],
        capture_output=True,
        text=True,
        check=True,
    )
    assert applied.stdout == (out / "corrected.xml").read_text()


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
