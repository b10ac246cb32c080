"""`trueup convert`: write a fetched model in a format that other programs read."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Sequence
from functools import singledispatch
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

import trueup
from trueup.artifact.model import Model, load
from trueup.artifact.onnx import to_onnx
from trueup.errors import NotExportable
from trueup.export.fmu import write_fmu
from trueup.export.targets import TARGETS, Asked, export
from trueup.model.corrected import Corrected
from trueup.model.dynamics import CompiledFamily, Dynamics
from trueup.model.mjcf import compile_file
from trueup.model.mjcf_check import differences
from trueup.model.mjcf_family import mjcf_of_joint
from trueup.model.mjcf_patch import Left, patch
from trueup.model.mjcf_writer import Written, write
from trueup.model.predictor import Physical
from trueup_cli.options import Json
from trueup_cli.show import as_json, progress, say

MODEL_FOLDER, REPORT_FILE = "model", "report.json"


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
        if target is not None:
            asked = Asked(
                fetched.predictor, fetched.digest, trueup.__version__, report, step, inertia, asset
            )
            left: Sequence[Left] = export(asked, target, to)
        elif to.suffix in WRITERS:
            left = WRITERS[to.suffix](fetched, to, mjcf)
        else:
            raise NotExportable(
                f"{to.name} is of no form that is known",
                hint=f"End the file's name with {' or '.join(WRITERS)}, or name a --target.",
            )
    apart = differences(to, fetched.predictor) if target is None and to.suffix == ".xml" else ()
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
    if target is not None and inertia is None and fetched.plant.form.per_inertia:
        say("forces are per unit of inertia: --inertia makes newton metres of them")
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


def _onnx(model: Model, to: Path, _: Path | None) -> Sequence[Left]:
    to.write_bytes(to_onnx(model.predictor, model.digest))
    return ()


def _fmu(model: Model, to: Path, _: Path | None) -> Sequence[Left]:
    write_fmu(model.predictor, model.digest, to)
    return ()


def _xml(model: Model, to: Path, source: Path | None) -> Sequence[Left]:
    written = _mjcf(model, source)
    to.write_text(written.text)
    return written.left


WRITERS = {".onnx": _onnx, ".xml": _xml, ".fmu": _fmu}


def _mjcf(model: Model, source: Path | None) -> Written:
    predictor = model.predictor
    if isinstance(predictor, Physical):
        predictor = Corrected.of_numbers(predictor.plant, predictor.parameters)
    if not isinstance(predictor, Corrected):
        raise NotExportable(
            f"a predictor of the kind {predictor.kind!r} is no machine that MJCF can describe",
            hint="Write it as ONNX.",
        )
    heading = [
        f"{model.plant.name}, artifact {model.digest}, written by trueup {trueup.__version__}"
    ]
    return _written(model.plant.dynamics, predictor, source, heading)


@singledispatch
def _written(_: Dynamics, predictor: Corrected, source: Path | None, heading: list[str]) -> Written:
    nominal: Any = predictor.plant.document["nominal"]
    if source is None:
        raise NotExportable(
            "the model of a robot is written into the file that it was declared by",
            hint=(
                "Name that file with --mjcf; its SHA-256 is "
                f"{nominal.get('sha256') or 'not known'}."
            ),
        )
    sha256 = compile_file(source).sha256
    if sha256 != nominal.get("sha256"):
        raise NotExportable(
            f"{source.name} is not the file that the robot was declared by",
            hint=f"Name the one whose SHA-256 is {nominal.get('sha256')}; this one's is {sha256}.",
        )
    return write(source, patch(predictor), heading)


@_written.register
def _written_joint(
    _: CompiledFamily, predictor: Corrected, source: Path | None, heading: list[str]
) -> Written:
    with tempfile.TemporaryDirectory() as folder:
        return mjcf_of_joint(predictor, Path(folder), heading)
