"""`trueup convert`: a fetched model as a file that other programs read, or a refusal that says what
to do."""

import json

import mujoco
import numpy as np
import onnx
import pytest

import trueup
from tests.support.made import plant_document
from tests.support.robots import ARM, arm_plant
from tests.unit.artifact.test_model import kept
from tests.unit.model.test_mjcf_family import model_of
from trueup.errors import NotExportable
from trueup.model.plant import Plant
from trueup.model.predictor import Identified, LinearMap, Nominal, Residual
from trueup_cli.convert import convert


def test_one_joint_becomes_onnx_and_mjcf(tmp_path, capsys):
    digest = kept(
        model_of("oscillator", {"backlash": {"gap": 0.1}, "coulomb_friction": {"level": 0.1}}),
        tmp_path / "m",
    )
    convert(tmp_path / "m", tmp_path / "m.onnx", as_json_=True)
    printed = json.loads(capsys.readouterr().out)
    assert printed == {"file": str(tmp_path / "m.onnx"), "artifact": digest, "not_expressed": []}
    assert {p.value for p in onnx.load(tmp_path / "m.onnx").metadata_props} > {digest}
    convert(tmp_path / "m", tmp_path / "m.xml")
    assert "not expressed: backlash at joint: apply the play to ctrl" in capsys.readouterr().out
    assert mujoco.MjModel.from_xml_path(str(tmp_path / "m.xml")).nv == 1


@pytest.mark.parametrize("family", ["oscillator", "pendulum", "inertia"])
def test_the_written_file_is_run_in_mujoco_beside_the_model(family, tmp_path, capsys):
    kept(model_of(family, {"coulomb_friction": {"level": 0.1}}), tmp_path / "m")
    convert(tmp_path / "m", tmp_path / "m.xml", as_json_=True)
    (q, *_) = json.loads(capsys.readouterr().out)["in_mujoco"]
    assert q["rms"] < 0.02 * q["motion"]
    kept(model_of(family, {"backlash": {"gap": 0.3}}), tmp_path / "without")
    convert(tmp_path / "without", tmp_path / "w.xml", as_json_=True)
    (q, *_) = json.loads(capsys.readouterr().out)["in_mujoco"]
    assert q["rms"] > 0.02 * q["motion"]
    convert(tmp_path / "m", tmp_path / "m.xml")
    assert "in MuJoCo, on the same commands: q differs by" in capsys.readouterr().out


def test_a_robot_is_written_into_its_own_file(tmp_path):
    plant = arm_plant(tmp_path)
    heavier = list(plant.parameters)
    heavier[-1] += 0.25  # friction loss of the last joint
    kept(Identified(plant, tuple(heavier)), tmp_path / "m")
    (tmp_path / "own.xml").write_text(ARM)
    convert(tmp_path / "m", tmp_path / "corrected.xml", mjcf=tmp_path / "own.xml")
    text = (tmp_path / "corrected.xml").read_text()
    (tmp_path / "other.xml").write_text(ARM.replace('mass="1.6"', 'mass="5.6"'))
    with pytest.raises(NotExportable, match=r"other\.xml is not the file"):
        convert(tmp_path / "m", tmp_path / "o.xml", mjcf=tmp_path / "other.xml")
    assert not (tmp_path / "o.xml").exists()
    assert 'frictionloss="0.25"' in text
    with pytest.raises(NotExportable, match="the file that it was declared by") as refused:
        convert(tmp_path / "m", tmp_path / "corrected.xml")
    assert plant.document["nominal"]["sha256"] in refused.value.hint
    convert(tmp_path / "m", tmp_path / "m.onnx")
    assert (tmp_path / "m.onnx").stat().st_size > 0


def test_a_notebook_writes_what_the_command_does(tmp_path):
    kept(model_of("oscillator", {"backlash": {"gap": 0.1}}), tmp_path / "m")
    convert(tmp_path / "m", tmp_path / "by command.onnx")
    model = trueup.load(tmp_path / "m")
    assert trueup.convert(model, tmp_path / "m.onnx") == ()
    assert (tmp_path / "m.onnx").read_bytes() == (tmp_path / "by command.onnx").read_bytes()
    (left,) = trueup.convert(model, tmp_path / "m.xml")
    assert left.startswith("backlash at joint: ")


def test_what_has_no_form_is_refused(tmp_path):
    plant = Plant.from_document(plant_document())
    kept(Residual(plant, LinearMap(("v",), np.zeros((1, 2)))), tmp_path / "m")
    with pytest.raises(NotExportable, match="no machine that MJCF can describe"):
        convert(tmp_path / "m", tmp_path / "m.xml")
    kept(Nominal(plant), tmp_path / "m")
    with pytest.raises(NotExportable, match="of no form") as refused:
        convert(tmp_path / "m", tmp_path / "m.urdf")
    assert "End the file's name with .onnx or .fmu or .xml" in refused.value.hint
    assert not (tmp_path / "m.urdf").exists()
