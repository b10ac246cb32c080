"""`trueup convert`: write a fetched model in a format that other programs read."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

import trueup
from trueup.artifact.model import Model, load
from trueup.errors import NotExportable
from trueup.export.configuration import as_forces
from trueup.export.targets import FORMATS, TARGETS, Asked, export
from trueup.model.mjcf_check import differences
from trueup_cli.options import Json
from trueup_cli.show import as_json, progress, say

MODEL_FOLDER, REPORT_FILE = "model", "report.json"
# targets whose forces are per unit of inertia where none is given
PER_INERTIA = "isaaclab", "mjlab", "ros2_control", "usd"


def convert(
    model: Path,
    to: Path,
    *,
    target: Annotated[
        str | None,
        Parameter(help=f"Program that it is written for: {', '.join(TARGETS)}"),
    ] = None,
    step: Annotated[
        float | None, Parameter(help="Physics step of the target [s]; default: the plant's")
    ] = None,
    inertia: Annotated[
        float | None, Parameter(help="Inertia of a single joint [kg m^2, or kg]; default: 1")
    ] = None,
    asset: Path | None = None,
    mjcf: Path | None = None,
    as_json_: Json = False,
) -> None:
    """Write a model for another program.

    Without a target: ONNX (`*.onnx`) holds one step of the model, an FMU (`*.fmu`) that step as a
    unit of FMI 3.0, MJCF (`*.xml`) the part of it that MuJoCo has elements for. Isaac Lab and mjlab
    get actuator configurations with events that randomise them over their 95 % intervals,
    ros2_control a proposal of compensating parameters, USD a layer over the robot's asset.

    Parameters
    ----------
    model
        folder of a fetched model, or of a diagnosis, which brings intervals
    to
        file to write; its suffix says in which format
    asset
        USD file of the robot, over which a layer of USD lies
    mjcf
        MJCF file that a robot was declared by; the correction is written into a copy of it
    """
    fetched, report = _read(model)
    with progress(f"writing {to.name}"):
        asked = Asked(
            fetched.predictor,
            fetched.digest,
            trueup.__version__,
            report,
            step,
            inertia,
            asset,
            mjcf,
        )
        left = export(asked, target, to)
        apart = differences(to, fetched.predictor) if to.suffix == ".xml" else ()
    if as_json_:
        as_json(
            {
                "file": str(to),
                "artifact": fetched.digest,
                "not_expressed": [x.document() for x in left],
                **({"in_mujoco": [d.document() for d in apart]} if apart else {}),
            }
        )
        return
    say("{}: {}, artifact {}", to, fetched.plant.name, fetched.digest[:12])
    chosen = target or FORMATS.get(to.suffix)
    if chosen in PER_INERTIA and inertia is None and fetched.plant.form.per_inertia:
        say("forces are per unit of inertia: {}", as_forces(fetched.plant))
    for x in left:
        say("not expressed: {}", x)
    for d in apart:
        say(
            "in MuJoCo, on the same commands: {} differs by {:.2g} {}, {:.2g} % of its motion",
            d.channel,
            d.rms,
            d.unit,
            100.0 * d.share,
        )


def _read(folder: Path) -> tuple[Model, dict[str, Any] | None]:
    """Returns the model in a folder, and the report of its diagnosis if that is one's folder."""
    if not folder.is_dir():
        raise NotExportable(
            f"there is no folder {folder}",
            hint="Name one that `trueup fetch` or `trueup diagnose --out` wrote.",
        )
    report = folder / REPORT_FILE
    if (folder / MODEL_FOLDER).is_dir() and report.is_file():
        return load(folder / MODEL_FOLDER), json.loads(report.read_bytes())
    return load(folder), None
