"""Diagnose a case, and look at the answer."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

from trueup.artifact.artifact import Artifact
from trueup.artifact.model import Model, save
from trueup.canonical import Json
from trueup.diagnose import diagnosis as engine
from trueup.diagnose.figures import figures
from trueup.diagnose.summary_text import composition, estimated, sentence
from trueup.diagnose.summary_warnings import warnings
from trueup.notebook.case import Case
from trueup.notebook.conversion import convert
from trueup.notebook.html import diagnosis_html

if TYPE_CHECKING:
    from trueup.notebook.plots import Plots

Progress = Callable[[str, float], None]


@dataclass(frozen=True, slots=True)
class Estimate:
    """A number with its unit and its 95 % interval, None where none could be told."""

    value: float
    unit: str
    ci95: tuple[float, float] | None

    def __repr__(self) -> str:
        width = "" if self.ci95 is None else f" ± {(self.ci95[1] - self.ci95[0]) / 2.0:.2g}"
        return f"{self.value:.4g}{width} {self.unit}".rstrip()


@dataclass(frozen=True)
class FittedEffect:
    """An effect of the answer: its numbers by name, and its share of what the answer explains."""

    effect: str
    joint: str | None
    port: str
    estimates: Mapping[str, Estimate]
    share: float | None

    def __repr__(self) -> str:
        numbers = ", ".join(f"{name} = {number}" for name, number in self.estimates.items())
        at = f" at {self.joint}" if self.joint else ""
        return f"{self.effect}{at}({numbers})"


@dataclass(frozen=True)
class Gap:
    """The error of predictions on held-out episodes, in standard deviations of each channel, over
    `horizon_s` [s]: of the nominal model, of it refitted, of the answer's effects on the declared
    parameters (None where it has none), of the answer; the floor that noise alone leaves; and
    which part of the gap above it is closed, None where there is none."""

    horizon_s: float
    before: float
    parameters_only: float
    effects_only: float | None
    after: float
    floor: float
    closed: float | None
    ci95: tuple[float, float] | None


@dataclass(frozen=True)
class Diagnosis:
    """What a diagnosis says of a case. `report` is the whole of it as JSON, as report.json holds
    it."""

    case: Case
    report: Mapping[str, Json]
    engine: engine.Diagnosis

    @property
    def verdict(self) -> str:
        """`effect`, `parameters_only`, `no_gap` or `unknown_effect`."""
        return str(self.report["verdict"])

    @property
    def sentence(self) -> str:
        """The answer in a sentence, with its figures."""
        return sentence(self.report)

    @property
    def warnings(self) -> list[str]:
        """What to know before the answer is used."""
        return warnings(self.report)

    @cached_property
    def effects(self) -> tuple[FittedEffect, ...]:
        """The effects of the answer, none where refitting or nothing closes the gap."""
        return tuple(
            FittedEffect(
                entry["effect"],
                entry.get("joint"),
                entry["port"],
                {name: _estimate(number) for name, number in estimated(entry)},
                entry["share"],
            )
            for entry in _list(self.report["effects"])
        )

    @property
    def alternatives(self) -> tuple[str, ...]:
        """Every other composition that the recordings cannot tell from the answer."""
        return tuple(composition(other) for other in _list(self.report["indistinguishable"]))

    @cached_property
    def parameters(self) -> Mapping[str, Estimate]:
        """The corrected numbers of the nominal form by name."""
        return {
            name: _estimate({"unit": "", **number})
            for name, number in _mapping(self.report["parameters"]).items()
        }

    @property
    def gap(self) -> Gap:
        """How far the error on held-out episodes shrinks."""
        gap = _mapping(self.report["gap"])
        ci95 = gap.get("ci95")
        return Gap(
            gap["horizon_s"],
            gap["before"],
            gap["parameters_only"],
            gap.get("effects_only"),
            gap["after"],
            gap["floor"],
            gap["closed"],
            None if ci95 is None else (ci95[0], ci95[1]),
        )

    @property
    def where(self) -> Mapping[str, Any]:
        """Where the gap lies: shares by channel, port and region."""
        return _mapping(self.report["where"])

    @cached_property
    def artifact(self) -> Artifact:
        """The corrected model as an artifact, named by its digest."""
        return self.engine.artifact(self.case.episodes)

    @cached_property
    def model(self) -> Model:
        """The corrected model: predicts recordings, rolls out commands."""
        return Model(self.engine.predictor, self.artifact.digest)

    @cached_property
    def figures(self) -> Mapping[str, Any]:
        """The numbers behind the pictures: held-out predictions and maps of what is missed."""
        return figures(self.engine)

    @property
    def plot(self) -> Plots:
        """Pictures for a paper. Needs matplotlib."""
        from trueup.notebook.plots import Plots  # noqa: PLC0415  (matplotlib is optional)

        return Plots(self)

    def export(
        self,
        to: str | PathLike[str],
        target: str | None = None,
        *,
        step_s: float | None = None,
        inertia: float | None = None,
        asset: str | PathLike[str] | None = None,
        mjcf: str | PathLike[str] | None = None,
    ) -> tuple[str, ...]:
        """Write the corrected model for another program, as `convert` does, with the intervals of
        its numbers. Raises NotExportable."""
        return convert(
            self.model,
            to,
            target,
            step_s=step_s,
            inertia=inertia,
            asset=asset,
            mjcf=mjcf,
            report=self.report,
        )

    def save(self, folder: str | PathLike[str]) -> Path:
        """Write report.json and the corrected model to a folder, as `trueup diagnose` does."""
        to = Path(folder)
        save(self.artifact, to / "model")
        (to / "report.json").write_text(json.dumps(self.report, indent=1) + "\n")
        return to

    def __repr__(self) -> str:
        return self.sentence

    def _repr_html_(self) -> str:
        return diagnosis_html(self.report, self.figures)


def diagnose(case: Case, *, seed: int = 0, progress: bool | Progress = False) -> Diagnosis:
    """Find where the gap between a case's model and its recordings lies, which effect causes it,
    and how far it shrinks on held-out episodes.

    `progress=True` prints each stage; a function gets its words and which part is done, 0 to 1.
    Raises NotIdentifiable where nothing was recorded to fit or to compare on.
    """
    of_case = engine.diagnose(case.plant, case.episodes, seed, shown(progress))
    return Diagnosis(case, of_case.document, of_case)


def shown(progress: bool | Progress) -> Progress:
    """What is called with each stage and the part that is done: nothing, a printer, or a function
    of the user's."""
    if progress is True:
        return _print
    return progress or _nothing


def _nothing(_stage: str, _part: float) -> None:
    pass


def _print(stage: str, part: float) -> None:
    end = "\n" if part >= 1.0 else ""
    print(f"\r{100.0 * part:3.0f} %  {stage:<60}", end=end, file=sys.stderr, flush=True)


def _estimate(number: Mapping[str, Any]) -> Estimate:
    ci95 = number.get("ci95")
    bounds = None if not ci95 or None in ci95 else (float(ci95[0]), float(ci95[1]))
    return Estimate(float(number["value"]), str(number.get("unit", "")), bounds)


def _list(value: Any) -> list[Any]:
    return list(value)


def _mapping(value: Any) -> dict[str, Any]:
    return dict(value)
