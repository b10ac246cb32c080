"""Targets: the programs that a corrected model is written for, by name."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from trueup.errors import NotExportable
from trueup.export import isaaclab, mjlab, ros2_control, usd
from trueup.export.joint_drive import Drives, drives_of
from trueup.model.corrected import Corrected
from trueup.model.mjcf_patch import Left
from trueup.model.predictor import Predictor
from trueup.randomise.supported import supported_ranges

Report = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Asked:
    """What is to be written: a predictor with its digest, the report of its diagnosis if there is
    one, the physics step of the target [s], the inertia of a family's joint, and the asset that a
    layer of USD lies over."""

    predictor: Predictor
    digest: str
    version: str
    report: Report | None = None
    step_s: float | None = None
    inertia: float | None = None
    asset: Path | None = None

    @property
    def drives(self) -> Drives:
        """The drives of its joints. Raises NotExportable."""
        return drives_of(self.predictor, self.digest, self.report, self.inertia)

    @property
    def step(self) -> float:
        """The physics step [s], the plant's if none is given."""
        return self.step_s or self.predictor.plant.timestep_s


def _isaaclab(asked: Asked, to: Path) -> str:
    write = isaaclab.yaml if to.suffix in YAML else isaaclab.python
    return write(asked.drives, asked.step, asked.version)


def _mjlab(asked: Asked, _: Path) -> str:
    return mjlab.python(asked.drives, asked.step, asked.version)


def _ros2_control(asked: Asked, _: Path) -> str:
    return ros2_control.yaml(asked.drives, asked.report, asked.version)


def _usd(asked: Asked, to: Path) -> str:
    return usd.layer(asked.drives, asked.asset, to, asked.version)


def _randomisation(asked: Asked, _: Path) -> str:
    if asked.report is None or not isinstance(asked.predictor, Corrected):
        raise NotExportable(
            "ranges come from the intervals of a diagnosis",
            hint="Name the folder that `trueup diagnose` wrote.",
        )
    ranges = supported_ranges(asked.predictor, asked.report)
    if ranges is None:
        raise NotExportable("no number of this diagnosis has an interval")
    return json.dumps(ranges, indent=1) + "\n"


YAML = (".yaml", ".yml")
# of each target the ends of its files, and what writes them
TARGETS: Mapping[str, tuple[tuple[str, ...], Callable[[Asked, Path], str]]] = {
    "isaaclab": ((".py", *YAML), _isaaclab),
    "mjlab": ((".py",), _mjlab),
    "ros2_control": (YAML, _ros2_control),
    "usd": ((".usda",), _usd),
    "randomisation": ((".json",), _randomisation),
}


def export(asked: Asked, target: str, to: Path) -> tuple[Left, ...]:
    """Write a model for a target into a file; what it cannot hold. Raises NotExportable."""
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
    to.write_text(write(asked, to))
    return () if target == "randomisation" else asked.drives.left
