"""Conversion: a model, written for another program."""

from __future__ import annotations

from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import Any

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
    report: Mapping[str, Any] | None = None,
) -> tuple[str, ...]:
    """Write a model for another program, as `trueup convert` does.

    `target` is isaaclab, mjlab, ros2_control, usd, randomisation, onnx, fmu or mjcf; without one,
    the file's end tells it: .usda, .onnx, .fmu or .xml. `step_s` [s] is the physics step of the
    target, `inertia` [kg m^2, or kg] that of a single joint, `asset` the USD file over which a
    layer lies, `mjcf` the file that a robot was declared by, `report` that of the diagnosis which
    made the model, whose intervals are then written. Returns in words what the target cannot hold.
    Raises NotExportable.
    """
    asked = Asked(
        model.predictor,
        model.digest,
        trueup.__version__,
        report,
        step_s,
        inertia,
        None if asset is None else Path(asset),
        None if mjcf is None else Path(mjcf),
    )
    return tuple(map(str, export(asked, target, Path(to))))
