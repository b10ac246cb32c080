"""Design the next experiment."""

from __future__ import annotations

import json
from dataclasses import dataclass
from html import escape
from os import PathLike
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from trueup.collect.checklist import command_table
from trueup.diagnose.excitation_design import Allowed, Design, design
from trueup.notebook.case import Case
from trueup.notebook.diagnosis import Diagnosis, Progress, shown

__all__ = ["Allowed", "Experiment", "excite"]
Array = NDArray[np.float64]


@dataclass(frozen=True)
class Experiment:
    """A command to play, with what to check before. `design` is the whole of it."""

    design: Design

    @property
    def t_s(self) -> Array:
        """Times of the command [s], `(samples,)`."""
        return self.design.excitation.t_s

    @property
    def commands(self) -> Array:
        """The command of each channel in its unit, `(samples, commands)`."""
        plant = self.design.plant
        at = [plant.joint_of(c) for c in plant.layout.commands]
        return np.asarray(self.design.excitation.command[:, at])

    @property
    def check_first(self) -> list[str]:
        """What to check before it is played."""
        return self.design.check_first

    def save(self, folder: str | PathLike[str]) -> Path:
        """Write excitation.csv and excitation.json to a folder."""
        to = Path(folder)
        to.mkdir(parents=True, exist_ok=True)
        table = command_table(
            self.design.plant, self.t_s, self.design.excitation.command, self.check_first
        )
        (to / "excitation.csv").write_text(table, newline="")
        (to / "excitation.json").write_text(json.dumps(dict(self.design.document), indent=1) + "\n")
        return to

    def __repr__(self) -> str:
        head = f"{self.t_s[-1]:.3g} s of commands; check before you play them:"
        lines = [f"  {i}. {line}" for i, line in enumerate(self.check_first, 1)]
        others = [f"  not parted: {how}" for how in self.design.not_parted]
        return "\n".join([head, *lines, *others])

    def _repr_html_(self) -> str:
        items = "".join(f"<li>{escape(line)}</li>" for line in self.check_first)
        return (
            f"<p>{self.t_s[-1]:.3g} s of commands. Check before you play them:</p><ol>{items}</ol>"
        )


def excite(
    case: Case,
    diagnosis: Diagnosis | None = None,
    *,
    split: bool = False,
    allowed: Allowed | None = None,
    spread: float = 0.3,
    seed: int = 0,
    progress: bool | Progress = False,
) -> Experiment:
    """Design a bounded excitation for a case that is safe under every plausible model.

    With a `diagnosis`, those are its answer and its alternatives, which `split` separates; without
    one, `spread` is the relative 95 % interval of each nominal number. `allowed` bounds duration,
    band, rates and margins. Raises NotIdentifiable where no command within the bounds does it.
    """
    diagnosed = None if diagnosis is None else (diagnosis.engine.predictor, diagnosis.report)
    return Experiment(
        design(
            case.plant,
            case.episodes,
            allowed or Allowed(),
            diagnosed=diagnosed,
            spread=spread,
            split=split,
            seed=seed,
            progress=shown(progress),
        )
    )
