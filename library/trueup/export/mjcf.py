"""MJCF: a corrected model as the file of a robot, or of one joint, that MuJoCo simulates."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from functools import singledispatch
from pathlib import Path
from typing import Any

from trueup.errors import NotExportable
from trueup.model.corrected import TO_A_TARGET, Corrected
from trueup.model.dynamics import CompiledFamily, Dynamics
from trueup.model.mjcf import compile_file
from trueup.model.mjcf_family import mjcf_of_joint
from trueup.model.mjcf_patch import patch
from trueup.model.mjcf_writer import Written, write
from trueup.model.predictor import Predictor
from trueup.model.simulator.dynamics import SimulatedDynamics


def written(predictor: Predictor, source: Path | None, heading: Sequence[str]) -> Written:
    """A predictor as MJCF, `heading` as its comment; a robot's into `source`, the file that it was
    declared by. Raises NotExportable, NotInstalled without MuJoCo."""
    model = Corrected.form_of(predictor)
    if model is None:
        raise NotExportable(
            f"a predictor of the kind {predictor.kind!r} is no machine that MJCF can describe",
            hint="Write it as ONNX.",
        )
    return _written(model.plant.dynamics, model, source, heading)


@singledispatch
def _written(
    _: Dynamics, predictor: Corrected, source: Path | None, heading: Sequence[str]
) -> Written:
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
def _written_simulator(
    _: SimulatedDynamics, predictor: Corrected, source: Path | None, heading: Sequence[str]
) -> Written:
    raise NotExportable(
        f"{predictor.plant.name} is a simulator of your own: it has no MJCF to be written into",
        hint=TO_A_TARGET,
    )


@_written.register
def _written_joint(
    _: CompiledFamily, predictor: Corrected, source: Path | None, heading: Sequence[str]
) -> Written:
    with tempfile.TemporaryDirectory() as folder:
        return mjcf_of_joint(predictor, Path(folder), heading)
