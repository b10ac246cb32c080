"""A layer of USD over a robot's asset: opened over it, the joints have the corrected drives."""

import math

import pytest
from pxr import Gf, Usd, UsdGeom, UsdPhysics

from tests.unit.export.test_exports import asked, corrected, plant
from trueup.errors import NotExportable
from trueup.export.joint_drive import drives_of
from trueup.export.targets import export

PER_DEGREE = math.pi / 180.0


def asset_of(folder, joint="elbow", metres=1.0, kind=UsdPhysics.RevoluteJoint):
    """An arm of one joint, whose drive knows nothing."""
    file = folder / "assets" / "robot.usda"
    file.parent.mkdir(exist_ok=True)
    stage = Usd.Stage.CreateNew(str(file))
    UsdGeom.SetStageMetersPerUnit(stage, metres)
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/arm").GetPrim())
    made = kind.Define(stage, f"/arm/joints/{joint}")
    made.CreateAxisAttr("Z")
    drive = UsdPhysics.DriveAPI.Apply(made.GetPrim(), "angular")
    drive.CreateStiffnessAttr(1.0)
    stage.Save()
    return file


def written(folder, field, numbers, **more):
    of = plant(field)
    model = corrected(of, numbers)
    export(asked(model, asset=asset_of(folder), **more), "usd", folder / "corrected.usda")
    stage = Usd.Stage.Open(str(folder / "corrected.usda"))
    (drive,) = drives_of(model, "0" * 64).drives
    return stage, stage.GetPrimAtPath("/arm/joints/elbow"), drive


def test_a_servo_over_its_asset_has_what_was_found(tmp_path):
    stage, joint, drive = written(tmp_path, "position", {"coulomb_friction": {"level": 3.0}})
    assert stage.GetDefaultPrim().GetName() == "arm"
    assert joint.IsA(UsdPhysics.RevoluteJoint)
    angular = UsdPhysics.DriveAPI.Get(joint, "angular")
    stiffness, damping = angular.GetStiffnessAttr().Get(), angular.GetDampingAttr().Get()
    assert stiffness / PER_DEGREE == pytest.approx(drive["servo"].value, rel=1e-6)
    assert damping / PER_DEGREE == pytest.approx(drive["damping"].value, rel=1e-6)
    # of a schema that usd-core does not know, but Isaac Sim does
    assert "PhysxJointAxisAPI:angular" in joint.GetMetadata("apiSchemas").GetAppliedItems()
    of_axis = {
        name: joint.GetAttribute(f"physxJointAxis:angular:{name}").Get()
        for name in ("staticFrictionEffort", "dynamicFrictionEffort", "viscousFrictionCoefficient")
    }
    assert of_axis == {
        "staticFrictionEffort": pytest.approx(3.0),
        "dynamicFrictionEffort": pytest.approx(3.0),
        "viscousFrictionCoefficient": 0.0,
    }


def test_a_motor_has_its_damping_in_the_joint_and_its_limit_in_the_drive(tmp_path):
    _, joint, drive = written(tmp_path, "effort", {"saturation": {"limit": 0.4}})
    angular = UsdPhysics.DriveAPI.Get(joint, "angular")
    assert (angular.GetStiffnessAttr().Get(), angular.GetDampingAttr().Get()) == (0.0, 0.0)
    assert angular.GetMaxForceAttr().Get() == pytest.approx(drive["limit"].value, rel=1e-6)
    viscous = joint.GetAttribute("physxJointAxis:angular:viscousFrictionCoefficient").Get()
    assert viscous / PER_DEGREE == pytest.approx(drive["damping"].value, rel=1e-6)


def test_intervals_and_what_has_no_attribute_are_said(tmp_path):
    report = {
        "plant": "arm",
        "verdict": "effect",
        "parameters": {
            name: {"value": x, "ci95": [0.9 * x, 1.1 * x]}
            for name, x in (("k", 30.0), ("c", 2.0), ("b", 30.0))
        },
        "effects": [
            {
                "effect": "coulomb_friction",
                "joint": "elbow",
                "estimate": {"level": {"value": 3.0, "unit": "rad/s^2", "ci95": [2.0, 4.0]}},
                "share": 0.5,
            },
        ],
        "incomplete": None,
        "nearest": None,
        "findings": [],
        "indistinguishable": [],
        "gap": {"closed": 0.9, "before": 1.0, "after": 0.1, "floor": 0.01, "parameters_only": 0.9,
                "same_numbers": 1.0},
        "evidence": {"hypotheses": [], "misfit": 1.0},
    }  # fmt: skip
    numbers = {"coulomb_friction": {"level": 3.0}, "actuator_delay": {"delay": 0.02}}
    model = corrected(plant("effort"), numbers)
    export(
        asked(model, asset=asset_of(tmp_path), report=report), "usd", tmp_path / "corrected.usda"
    )
    stage = Usd.Stage.Open(str(tmp_path / "corrected.usda"))
    joint = stage.GetPrimAtPath("/arm/joints/elbow")
    effort = joint.GetAttribute("physxJointAxis:angular:dynamicFrictionEffort")
    assert Gf.IsClose(effort.GetCustomDataByKey("ci95"), Gf.Vec2d(2.0, 4.0), 0.05)
    assert "commands are late by 0.02 s" in (tmp_path / "corrected.usda").read_text()


@pytest.mark.parametrize(
    ("made", "why"),
    [
        (lambda folder: None, "there is none"),
        (lambda folder: asset_of(folder, joint="wrist"), "has no joint elbow"),
        (lambda folder: asset_of(folder, metres=0.01), "unit of length"),
    ],
)
def test_an_asset_that_does_not_fit_is_refused(made, why, tmp_path):
    model = corrected(plant("effort"), {})
    with pytest.raises(NotExportable, match=why):
        export(asked(model, asset=made(tmp_path)), "usd", tmp_path / "corrected.usda")


def test_a_slide_has_linear_attributes(tmp_path):
    model = corrected(plant("effort"), {"coulomb_friction": {"level": 3.0}})
    asset = asset_of(tmp_path, kind=UsdPhysics.PrismaticJoint)
    export(asked(model, asset=asset), "usd", tmp_path / "corrected.usda")
    stage = Usd.Stage.Open(str(tmp_path / "corrected.usda"))
    joint = stage.GetPrimAtPath("/arm/joints/elbow")
    effort = joint.GetAttribute("physxJointAxis:linear:dynamicFrictionEffort")
    assert effort.Get() == pytest.approx(3.0)
    viscous = joint.GetAttribute("physxJointAxis:linear:viscousFrictionCoefficient").Get()
    assert viscous == pytest.approx(2.0)
