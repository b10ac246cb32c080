"""`trueup convert`: a fetched model in a form that other programs read."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import trueup
from trueup.artifact.model import Model, load
from trueup.artifact.onnx import to_onnx
from trueup.errors import NotExportable
from trueup.model.corrected import Corrected
from trueup.model.dynamics import CompiledFamily
from trueup.model.mjcf import compile_file
from trueup.model.mjcf_family import mjcf_of_joint
from trueup.model.mjcf_patch import Left, patch
from trueup.model.mjcf_writer import Written, write
from trueup.model.predictor import Physical
from trueup_cli.options import Json
from trueup_cli.show import as_json, progress, say


def convert(model: Path, to: Path, *, mjcf: Path | None = None, as_json_: Json = False) -> None:
    """Write a fetched model as ONNX (`*.onnx`: its step, for any runtime) or as MJCF (`*.xml`: what
    of it MuJoCo has elements for).

    Parameters
    ----------
    model
        folder of a fetched model
    to
        file to write; its ending says which form
    mjcf
        file that a robot's model was declared by, into which the correction is written
    """
    found = load(model)
    with progress(f"writing {to.name}"):
        left = WRITERS[to.suffix](found, to, mjcf) if to.suffix in WRITERS else _of_no_form(to)
    if as_json_:
        as_json(
            {
                "file": str(to),
                "artifact": found.digest,
                "not_expressed": [x.document() for x in left],
            }
        )
        return
    say("{}: {}, artifact {}", to, found.plant.name, found.digest[:12])
    for x in left:
        say("not expressed: {}", x)


def _of_no_form(to: Path) -> Sequence[Left]:
    raise NotExportable(
        f"{to.name} is of no form that is known",
        hint=f"End the file's name with {' or '.join(WRITERS)}.",
    )


def _onnx(model: Model, to: Path, _: Path | None) -> Sequence[Left]:
    to.write_bytes(to_onnx(model.predictor, model.digest))
    return ()


def _xml(model: Model, to: Path, source: Path | None) -> Sequence[Left]:
    written = _mjcf(model, source)
    to.write_text(written.text)
    return written.left


WRITERS = {".onnx": _onnx, ".xml": _xml}


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
    if isinstance(model.plant.dynamics, CompiledFamily):
        with tempfile.TemporaryDirectory() as folder:
            return mjcf_of_joint(predictor, Path(folder), heading)
    nominal: Any = model.plant.document["nominal"]
    if source is None:
        raise NotExportable(
            "the model of a robot is written into the file that it was declared by",
            hint=(
                "Name that file with --mjcf; its SHA-256 is "
                f"{nominal.get('sha256') or 'not known'}."
            ),
        )
    found = compile_file(source).sha256
    if found != nominal.get("sha256"):
        raise NotExportable(
            f"{source.name} is not the file that the robot was declared by",
            hint=f"Name the one whose SHA-256 is {nominal.get('sha256')}; this one's is {found}.",
        )
    return write(source, patch(predictor), heading)
