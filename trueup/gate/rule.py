"""Rule: one reason for or against a candidate. Each file in `rules/` holds one; they are found by themselves."""

from __future__ import annotations

import importlib
import pkgutil
from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cache
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from trueup.canonical import Json
from trueup.control.closed_loop import Tracking
from trueup.errors import BadGate
from trueup.fit.score import Score
from trueup.gate.cells import Cell

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Trial:
    """Scores of a candidate and of the incumbent on the same held-out episodes, named by digest. Raises BadGate without any.

    `cells` are the values of the gate's `conditions` under which each was recorded; without conditions all are of one.
    `tracking` is how both did in closed loop, where a rule asks for it.
    """

    candidate: Score
    incumbent: Score
    episodes: tuple[str, ...]
    cells: tuple[Cell, ...] = ()
    conditions: tuple[str, ...] = ()
    tracking: Tracking | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "cells", self.cells or ((),) * len(self.episodes))
        shapes = {a.shape for s in (self.candidate, self.incumbent) for a in (s.rollout, s.one_step)}
        if not self.episodes or shapes != {(len(self.episodes),)} or len(self.cells) != len(self.episodes):
            raise BadGate("a trial needs scores of both predictors on one held-out episode at least")


@dataclass(frozen=True, slots=True)
class Verdict:
    """A rule's answer: the figure, the threshold it was held against, in `unit`, and the reason in words."""

    rule: str
    passed: bool
    value: float
    threshold: float
    unit: str
    because: str

    def document(self) -> dict[str, Json]:
        """The same as JSON; a figure that is no number stands as null."""
        value, threshold = (x if np.isfinite(x) else None for x in (self.value, self.threshold))
        return {
            "rule": self.rule,
            "passed": self.passed,
            "value": value,
            "threshold": threshold,
            "unit": self.unit,
            "because": self.because,
        }


class Rule(ABC):
    """A frozen dataclass whose one field bounds one figure. It answers; it never raises."""

    name: ClassVar[str]
    closed_loop: ClassVar[bool] = False  # whether it judges runs in closed loop

    @abstractmethod
    def __call__(self, trial: Trial) -> Verdict:
        """The verdict on a trial; a figure that is not a number never passes."""


@cache
def rules() -> dict[str, type[Rule]]:
    """Every rule there is, by name."""
    from trueup.gate import rules as package  # noqa: PLC0415  (the files import this module)

    for module in pkgutil.iter_modules(package.__path__):
        importlib.import_module(f"{package.__name__}.{module.name}")
    return {r.name: r for r in sorted(Rule.__subclasses__(), key=lambda r: r.name)}
