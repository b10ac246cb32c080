"""Targets: the programs and formats that a corrected model is written for, by name."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from trueup.artifact.onnx import to_onnx
from trueup.errors import NotExportable
from trueup.export import isaaclab, mjcf, mjlab, ros2_control, usd
from trueup.export.fmu import write_fmu
from trueup.export.joint_drive import Drives, drives_of
from trueup.export.provenance import Provenance
from trueup.model.corrected import Corrected
from trueup.model.mjcf_patch import Left
from trueup.model.predictor import Predictor
from trueup.randomise.supported import supported_ranges

Report = Mapping[str, Any]
YAML = (".yaml", ".yml")


@dataclass(frozen=True, slots=True)
class Asked:
    """What is to be written: a predictor with its digest, the report of its diagnosis if there is
    one, the physics step of the target [s], the inertia of a family's joint, the asset that a layer
    of USD lies over, and the MJCF that a robot was declared by."""

    predictor: Predictor
    digest: str
    version: str
    report: Report | None = None
    step_s: float | None = None
    inertia: float | None = None
    asset: Path | None = None
    mjcf: Path | None = None

    @property
    def drives(self) -> Drives:
        """The drives of its joints. Raises NotExportable."""
        return drives_of(self.predictor, self.digest, self.report, self.inertia)

    @property
    def step(self) -> float:
        """The physics step [s], the plant's if none is given."""
        return self.step_s or self.predictor.plant.timestep_s

    @property
    def provenance(self) -> Provenance | None:
        """What the diagnosis says, if there is one."""
        return None if self.report is None else Provenance.of(self.report)


def _isaaclab(asked: Asked, to: Path) -> Sequence[Left]:
    text = isaaclab.yaml if to.suffix in YAML else isaaclab.python
    return _drives(asked, to, text(asked.drives, asked.step, asked.version))


def _mjlab(asked: Asked, to: Path) -> Sequence[Left]:
    return _drives(asked, to, mjlab.python(asked.drives, asked.step, asked.version))


def _ros2_control(asked: Asked, to: Path) -> Sequence[Left]:
    return _drives(asked, to, ros2_control.yaml(asked.drives, asked.report, asked.version))


def _usd(asked: Asked, to: Path) -> Sequence[Left]:
    return _drives(asked, to, usd.layer(asked.drives, asked.asset, to, asked.version))


def _drives(asked: Asked, to: Path, text: str) -> Sequence[Left]:
    """Write the text that the drives became; what they cannot hold."""
    to.write_text(text)
    return asked.drives.left


def _randomisation(asked: Asked, to: Path) -> Sequence[Left]:
    if asked.report is None or not isinstance(asked.predictor, Corrected):
        raise NotExportable(
            "ranges come from the intervals of a diagnosis",
            hint="Name the folder that `trueup diagnose` wrote.",
        )
    ranges = supported_ranges(asked.predictor, asked.report)
    if ranges is None:
        raise NotExportable("no number of this diagnosis has an interval")
    to.write_text(json.dumps(ranges, indent=1) + "\n")
    return ()


def _onnx(asked: Asked, to: Path) -> Sequence[Left]:
    known = asked.provenance
    to.write_bytes(to_onnx(asked.predictor, asked.digest, known.document() if known else None))
    return ()


def _fmu(asked: Asked, to: Path) -> Sequence[Left]:
    known = asked.provenance
    write_fmu(asked.predictor, asked.digest, to, known.document() if known else None)
    return ()


def _mjcf(asked: Asked, to: Path) -> Sequence[Left]:
    plant, known = asked.predictor.plant, asked.provenance
    made = f"{plant.name}, artifact {asked.digest}, written by trueup {asked.version}"
    file = mjcf.written(asked.predictor, asked.mjcf, [made, *(known.lines() if known else ())])
    to.write_text(file.text)
    return file.left


# of each target the ends of its files, and what writes them
TARGETS: Mapping[str, tuple[tuple[str, ...], Callable[[Asked, Path], Sequence[Left]]]] = {
    "isaaclab": ((".py", *YAML), _isaaclab),
    "mjlab": ((".py",), _mjlab),
    "ros2_control": (YAML, _ros2_control),
    "usd": ((".usda",), _usd),
    "randomisation": ((".json",), _randomisation),
    "onnx": ((".onnx",), _onnx),
    "fmu": ((".fmu",), _fmu),
    "mjcf": ((".xml",), _mjcf),
}
# what the end of a file tells, where no target is named
FORMATS = {".onnx": "onnx", ".fmu": "fmu", ".xml": "mjcf", ".usda": "usd"}


def export(asked: Asked, target: str | None, to: Path) -> Sequence[Left]:
    """Write a model for a target, or in the format that the file's end names; what it cannot hold.
    Raises NotExportable."""
    if target is None:
        target = FORMATS.get(to.suffix)
        if target is None:
            raise NotExportable(
                f"{to.name} is of no form that is known",
                hint=f"End the file's name with {' or '.join(FORMATS)}, or name a target: "
                f"{', '.join(TARGETS)}.",
            )
    if target not in TARGETS:
        raise NotExportable(
            f"there is no target {target!r}", hint=f"There are {', '.join(TARGETS)}."
        )
    suffixes, write = TARGETS[target]
    if to.suffix not in suffixes:
        raise NotExportable(
            f"{to.name} is no file of {target}",
            hint=f"End the file's name with {' or '.join(suffixes)}.",
        )
    return write(asked, to)
