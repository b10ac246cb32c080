"""A stranger with a CSV, a bag of a ros2_control robot or a LeRobot dataset: two commands to a
verdict and to an Isaac Lab configuration."""

import json
import subprocess
import sys

import pytest

from tests.support import recorded
from tests.unit.export.simulators import read

RUNS = [recorded.simulated(1200, seed) for seed in range(4)]


def a_csv(folder):
    """One table of all, as a spreadsheet exports it."""
    folder.mkdir()
    for i, run in enumerate(RUNS):
        names = ["Time [ms]", "Angle (deg)", "Speed (deg/s)", "Torque cmd [Nm]"]
        recorded.as_csv(
            run,
            folder / f"run {i}.csv",
            names,
            delimiter=";",
            decimal=",",
            scale=[1e3, 180.0 / 3.141592653589793, 180.0 / 3.141592653589793, 1.0],
        )
    return folder


def a_bag(folder):
    """What a trajectory controller published, in a bag that defines no message."""
    folder.mkdir()
    for i, run in enumerate(RUNS):
        recorded.controller_bag(run, folder / f"rosbag2_{i}.db3")
    return folder


def a_dataset(folder):
    """A teleoperated servo, in degrees."""
    runs = [recorded.Run(r.stamps_ns, 5 * r.q, 5 * r.v, 5 * r.u) for r in RUNS]
    return recorded.as_lerobot(runs, folder, names=("elbow_flex.pos",))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("made", "kind"),
    [
        (a_csv, "IdealPDActuatorCfg"),
        (a_bag, "IdealPDActuatorCfg"),
        (a_dataset, "ImplicitActuatorCfg"),
    ],
)
def test_two_commands_lead_to_a_verdict_and_a_configuration(made, kind, tmp_path, monkeypatch):
    data = made(tmp_path / "recorded")
    command = [sys.executable, "-m", "trueup_cli.main"]
    for words in (
        ["diagnose", str(data), "--out", str(tmp_path / "d")],
        ["convert", str(tmp_path / "d"), str(tmp_path / "arm.py"), "--target", "isaaclab"],
    ):
        said = subprocess.run([*command, *words], capture_output=True, text=True, check=False)
        assert said.returncode == 0, said.stderr
    report = json.loads((tmp_path / "d" / "report.json").read_text())
    assert report["verdict"] == "effect"
    assert "coulomb_friction" in [e["effect"] for e in report["effects"]]
    actuators, _, events = read((tmp_path / "arm.py").read_text(), "isaaclab", monkeypatch)
    ((joint, config),) = actuators.items()
    assert config["kind"] == kind
    scale = 5.0 if made is a_dataset else 1.0
    assert config["friction"] == pytest.approx(0.6 * scale, rel=0.1)
    low, high = events[f"{joint}_joint"]["params"]["friction_distribution_params"]
    assert low < config["friction"] < high
    mapping = json.loads((tmp_path / "d" / "case" / "mapping.json").read_text())
    assert mapping["schema"] == "trueup.mapping/1"
