"""A functional mock-up unit, run by another importer, moves as the model does."""

import subprocess
import sys

import fmpy
import numpy as np
import pytest
from pythonfmu3.builder import FmuBuilder

from tests.support import fmu_run
from tests.unit.model.test_step_function import (
    PLANT,
    TOGETHER,
    commands,
    corrected,
    robot,
    robot_motion,
)
from trueup.export.fmu import write_fmu
from trueup.model.series import DECLARED, Scheme

pytestmark = pytest.mark.skipif(
    not FmuBuilder.has_binary(), reason="pythonfmu3 has no binary for this kind of machine"
)


def run(path, plant, start, issued):
    """Observations of a unit under commands; half a step is refused."""
    names = [f"_{j}" for j in plant.joints] if len(plant.joints) > 1 else [""]
    np.savez(
        path.with_suffix(".npz"),
        start=start,
        starts=[f"start_{what}{name}" for what in ("position", "velocity") for name in names],
        inputs=[c.name for c in plant.layout.commands],
        outputs=[c.name for c in plant.layout.observations],
        issued=issued,
        period_s=plant.timestep_s,
    )
    files = [path, path.with_suffix(".npz"), path.with_suffix(".npy")]
    done = subprocess.run(
        [sys.executable, fmu_run.__file__, *map(str, files)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert "refused" in done.stdout
    assert "a whole number of periods" in done.stdout + done.stderr
    return np.load(files[2])


def test_a_joints_unit_moves_as_the_model_does(tmp_path):
    model, start, issued = corrected(TOGETHER, DECLARED), (0.3, -0.2), commands()
    write_fmu(model, "a" * 64, tmp_path / "joint.fmu")
    moved = run(tmp_path / "joint.fmu", PLANT, start, issued)
    assert np.abs(moved - PLANT.observe(model.run(np.array(start), issued))).max() < 1e-9


def test_a_robots_unit_moves_as_the_model_does(tmp_path):
    at = (("coulomb_friction", 0), ("actuator_delay", 0), ("sensor_delay", 2), ("actuator_lag", 3))
    model = robot(at, Scheme(0.5, 2))
    start, issued = robot_motion(model.plant)
    write_fmu(model, "a" * 64, tmp_path / "robot.fmu")
    moved = run(tmp_path / "robot.fmu", model.plant, start, issued)
    assert np.abs(moved - model.plant.observe(model.run(start, issued))).max() < 1e-9
    described = fmpy.read_model_description(str(tmp_path / "robot.fmu"))
    assert described.fmiVersion == "3.0"
    assert "a" * 64 in described.description
