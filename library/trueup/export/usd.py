"""USD: a layer over a robot's asset that holds the corrected drives of its joints.

The asset stays as it is: the layer names it as what lies below, and says only what was found. A
stage that opens the layer is the corrected robot. Angular gains are per degree in USD, and so is
viscous friction; efforts are not. Each attribute carries its 95 % interval as `ci95` in its custom
data, in the same unit. Source: OpenUSD, UsdPhysics (DriveAPI); PhysX 5.6, PhysxJointAxisAPI, as
Isaac Sim 5 reads it.
"""

from __future__ import annotations

import importlib
import math
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from trueup.errors import NotExportable, NotInstalled
from trueup.export.configuration import heading
from trueup.export.joint_drive import Drives, JointDrive, Ranged

AXES = {"PhysicsRevoluteJoint": "angular", "PhysicsPrismaticJoint": "linear"}
PER_DEGREE = math.pi / 180.0


def layer(drives: Drives, asset: Path | None, to: Path, version: str) -> str:
    """The layer as text, for a file `to` beside an `asset`. Raises NotExportable, NotInstalled
    without usd-core."""
    sdf, usd, physics = (_module(name) for name in ("Sdf", "Usd", "UsdPhysics"))
    if asset is None or not asset.is_file():
        raise NotExportable(
            "USD is a layer over an asset, and there is none",
            hint="Name the robot's USD file: --asset robot.usd.",
        )
    below = usd.Stage.Open(str(asset))
    _require_si(below, importlib.import_module("pxr.UsdGeom"))
    joints = {p.GetName(): p for p in below.Traverse() if str(p.GetTypeName()) in AXES}
    written = sdf.Layer.CreateAnonymous(".usda")
    written.comment = "\n".join(heading(drives, version, [*_said_beside(drives)]))
    written.subLayerPaths.append(os.path.relpath(asset.resolve(), to.resolve().parent))
    stage = usd.Stage.Open(written)
    stage.SetEditTarget(written)
    if below.GetDefaultPrim():
        written.defaultPrim = below.GetDefaultPrim().GetName()
    for drive in drives.drives:
        if drive.joint not in joints:
            raise NotExportable(
                f"{asset.name} has no joint {drive.joint}",
                hint=f"Its joints are {', '.join(joints) or 'none'}.",
            )
        joint = joints[drive.joint]
        axis = AXES[str(joint.GetTypeName())]
        prim = stage.OverridePrim(joint.GetPath())
        physics.DriveAPI.Apply(prim, axis)
        prim.AddAppliedSchema(f"PhysxJointAxisAPI:{axis}")
        for name, ranged in _attributes(drive, axis):
            attribute = prim.CreateAttribute(name, sdf.ValueTypeNames.Float, custom=False)
            attribute.Set(ranged.value)
            if not ranged.is_certain:
                attribute.SetCustomDataByKey("ci95", _pair(ranged))
    return str(written.ExportToString())


def _attributes(drive: JointDrive, axis: str) -> Iterator[tuple[str, Ranged]]:
    """The attributes of a joint, in USD's units."""
    per = PER_DEGREE if axis == "angular" else 1.0
    of_drive, of_axis = f"drive:{axis}:physics", f"physxJointAxis:{axis}"
    none = Ranged.exactly(0.0)
    servo = drive.commands_position
    damping = _times(drive["damping"], per)
    yield f"{of_drive}:stiffness", _times(drive["servo"], per)
    yield f"{of_drive}:damping", damping if servo else none
    if math.isfinite(drive["limit"].value):
        yield f"{of_drive}:maxForce", drive["limit"]
    yield f"{of_axis}:viscousFrictionCoefficient", none if servo else damping
    yield f"{of_axis}:armature", drive["armature"]
    yield f"{of_axis}:staticFrictionEffort", drive["breakaway"]
    yield f"{of_axis}:dynamicFrictionEffort", drive["friction"]


def _said_beside(drives: Drives) -> Iterator[str]:
    """What a drive of USD has no attribute for."""
    if drives.beside:
        yield drives.beside
    for drive in drives.drives:
        for name, words in (
            ("delay", "commands are late by {:g} s"),
            ("offset", "a constant force of {:g} acts"),
            ("spring", "a passive spring of {:g} acts beside the drive"),
        ):
            if drive[name].value:
                yield f"{drive.joint}: {words.format(drive[name].value)}."


def _times(ranged: Ranged, factor: float) -> Ranged:
    return Ranged(factor * ranged.value, factor * ranged.low, factor * ranged.high)


def _pair(ranged: Ranged) -> Any:
    return importlib.import_module("pxr.Gf").Vec2d(ranged.low, ranged.high)


def _require_si(stage: Any, geometry: Any) -> None:
    """Raises NotExportable of a stage whose unit of length is not the metre."""
    unit = float(geometry.GetStageMetersPerUnit(stage))
    if unit != 1.0:
        raise NotExportable(
            f"the asset's unit of length is {unit:g} m, and forces are in newtons and metres",
            hint="Convert the asset to metres first.",
        )


def _module(name: str) -> Any:
    try:
        return importlib.import_module(f"pxr.{name}")  # optional, and slow to load
    except ImportError as error:
        raise NotInstalled(
            "writing USD needs the package usd-core",
            hint="Install it with `pip install 'trueup[usd]'`.",
        ) from error
