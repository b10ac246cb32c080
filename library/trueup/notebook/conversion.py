"""Conversion: a fetched model, written for another program."""

from __future__ import annotations

from os import PathLike
from pathlib import Path

import trueup
from trueup.artifact.model import Model
from trueup.export.targets import Asked, export


def convert(
    model: Model,
    to: str | PathLike[str],
    target: str | None = None,
    *,
    step_s: float | None = None,
    inertia: float | None = None,
    asset: str | PathLike[str] | None = None,
    mjcf: str | PathLike[str] | None = None,
) -> tuple[str, ...]:
    """Write a model for another program, as `trueup convert` does.

    The ends .onnx, .fmu, .xml and .usda tell the format; else `target` is isaaclab, mjlab or
    ros2_control. `step_s` [s] is the physics step of the target, `inertia` [kg m^2, or kg] that of
    a single joint, `asset` the USD file over which a layer lies, `mjcf` the file that a robot was
    declared by. The intervals of a diagnosis are written by its own `export`. Returns in words what
    the target cannot hold. Raises NotExportable.
    """
    asked = Asked(
        model.predictor,
        model.digest,
        trueup.__version__,
        step_s=step_s,
        inertia=inertia,
        asset=None if asset is None else Path(asset),
        mjcf=None if mjcf is None else Path(mjcf),
    )
    return tuple(map(str, export(asked, target, Path(to))))
