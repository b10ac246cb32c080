"""Rule: one reason for or against a candidate. Each file in `rules/` holds one, and is
discovered."""

from __future__ import annotations

import importlib
import pkgutil
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields
from functools import cache, cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from trueup.canonical import Json
from trueup.control.closed_loop import Tracking
from trueup.errors import BadGate
from trueup.fit.score import Score
from trueup.gate.cells import Cell
from trueup.gate.interval import Pairs, ratio_interval

Array = NDArray[np.float64]
MEAN, BOUND = "mean", "bound"
ROLLOUT, ONE_STEP = "rollout", "one_step"


Interval = Callable[[], tuple[float, float] | None]


@dataclass(frozen=True)
class Compared:
    """Mean errors of both models, and a function that draws the 95 % interval of the candidate's
    over the incumbent's."""

    candidate: float
    incumbent: float
    interval: Interval

    @cached_property
    def ci95(self) -> tuple[float, float] | None:
        """The interval; None where there is none."""
        return self.interval()

    @property
    def ratio(self) -> float:
        """The candidate's mean error over the incumbent's; nan where the incumbent's is 0 or not a
        number."""
        return self.candidate / self.incumbent if self.incumbent > 0.0 else float("nan")


@dataclass(frozen=True, slots=True)
class Trial:
    """Scores of a candidate and of the incumbent on the same held-out episodes, which are named by
    digest. Raises BadGate without any.

    `cells` are the values of the gate's `conditions` under which each was recorded; without
    conditions, all are of one cell. `tracking` holds the closed-loop runs of both, where a rule
    asks for them.
    """

    candidate: Score
    incumbent: Score
    episodes: tuple[str, ...]
    cells: tuple[Cell, ...] = ()
    conditions: tuple[str, ...] = ()
    tracking: Tracking | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "cells", self.cells or ((),) * len(self.episodes))
        shapes = {
            a.shape for s in (self.candidate, self.incumbent) for a in (s.rollout, s.one_step)
        }
        if (
            not self.episodes
            or shapes != {(len(self.episodes),)}
            or len(self.cells) != len(self.episodes)
        ):
            raise BadGate(
                "a trial needs scores of both predictors on one held-out episode at least"
            )

    def compared(self, error: str, of: Sequence[int] | None = None) -> Compared:
        """Mean `rollout` or `one_step` errors over the episodes numbered `of`, or over all."""
        chosen = list(range(len(self.episodes)) if of is None else of)
        candidate, incumbent = (
            float(np.mean(getattr(s, error)[chosen])) for s in (self.candidate, self.incumbent)
        )
        return Compared(
            candidate, incumbent, lambda: ratio_interval([self._pairs(error, i) for i in chosen])
        )

    def _pairs(self, error: str, episode: int) -> Pairs:
        """Both models' errors by window; an episode whose windows are not known counts as one."""
        if not (self.candidate.windows and self.incumbent.windows):
            only = slice(episode, episode + 1)
            return Pairs(
                getattr(self.candidate, error)[only],
                getattr(self.incumbent, error)[only],
                np.ones(1),
            )
        ours, theirs = self.candidate.windows[episode], self.incumbent.windows[episode]
        # every window has one first step
        weights = theirs.samples if error == ROLLOUT else np.ones_like(theirs.samples)
        return Pairs(getattr(ours, error), getattr(theirs, error), weights)


@dataclass(frozen=True, slots=True)
class Verdict:
    """A rule's answer: the figure, its threshold in `unit`, and the reason in words.

    `compared` has the ratio of the candidate's error to the incumbent's, and its interval; None
    where nothing could be compared. With `require` bound, not the mean but the upper end of the
    interval had to stay within the rule's bound.
    """

    rule: str
    passed: bool
    value: float
    threshold: float
    unit: str
    because: str
    compared: Compared | None = field(default=None, compare=False)
    require: str = MEAN

    @property
    def ratio(self) -> float:
        """The candidate's error over the incumbent's; nan where there is none."""
        return float("nan") if self.compared is None else self.compared.ratio

    @property
    def ci95(self) -> tuple[float, float] | None:
        """The 95 % interval of the ratio; None where there is none."""
        return None if self.compared is None else self.compared.ci95

    def document(self) -> dict[str, Json]:
        """The verdict as JSON; a figure that is not a number is null."""
        value, threshold, ratio = (
            x if np.isfinite(x) else None for x in (self.value, self.threshold, self.ratio)
        )
        return {
            "rule": self.rule,
            "passed": self.passed,
            "value": value,
            "threshold": threshold,
            "unit": self.unit,
            "because": self.because,
            "ratio": ratio,
            "ci95": None if self.ci95 is None else list(self.ci95),
            "require": self.require,
        }


class Rule(ABC):
    """A frozen dataclass whose first field bounds one figure: a larger bound is a looser rule. It
    answers; it never raises.

    `require` says what must stay within the bound: the `mean`, or the `bound` of its 95 % interval.
    """

    name: ClassVar[str]
    closed_loop: ClassVar[bool] = False  # whether it judges runs in closed loop
    require: str

    @abstractmethod
    def __call__(self, trial: Trial) -> Verdict:
        """The verdict on a trial; a figure that is not a number never passes."""

    def within(self, compared: Compared, bound: float, *, below: bool = False) -> bool:
        """Whether the required figure is at most, or `below`, `bound` times the incumbent's.
        Not-a-number is not."""
        if self.require == MEAN:
            error, most = compared.candidate, bound * compared.incumbent
        else:
            error, most = float("nan") if compared.ci95 is None else compared.ci95[1], bound
        return error < most if below else error <= most

    def nearest(self, each: Sequence[Compared], bound: float) -> int:
        """The index of the pair that is nearest to the bound, or furthest beyond it; of the first
        that is not a number, if there is one."""
        over = [self._over(compared, bound) for compared in each]
        return int(np.argmax(over))  # argmax stops at a nan; Python's max would pass over it

    def _over(self, compared: Compared, bound: float) -> float:
        if self.require == MEAN:
            # a difference: an incumbent's error may be 0
            return compared.candidate - bound * compared.incumbent
        return float("nan") if compared.ci95 is None else compared.ci95[1] - bound

    def verdict(self, passed: bool, compared: Compared, bound: float, because: str) -> Verdict:
        """The verdict in the figures' own units."""
        if self.require == BOUND and compared.ci95 is None:
            because = f"there is no interval: it takes two windows with an error, {because}"
        return Verdict(
            self.name,
            passed,
            compared.candidate,
            bound * compared.incumbent,
            "1",
            because,
            compared,
            self.require,
        )

    def document(self) -> dict[str, Json]:
        """The rule as JSON; `require` is left out where it is the mean."""
        values: dict[str, Any] = {f.name: getattr(self, f.name) for f in fields(self)}  # type: ignore[arg-type]
        return {
            "rule": self.name,
            **{name: value for name, value in values.items() if (name, value) != ("require", MEAN)},
        }


@cache
def rules() -> dict[str, type[Rule]]:
    """Every rule there is, by name."""
    from trueup.gate import rules as package  # noqa: PLC0415  (the files import this module)

    for module in pkgutil.iter_modules(package.__path__):
        importlib.import_module(f"{package.__name__}.{module.name}")
    return {r.name: r for r in sorted(Rule.__subclasses__(), key=lambda r: r.name)}
