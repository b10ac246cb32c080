"""Identifiability: what recordings can show at all, told before any effect is sought.

- A number of the nominal form is identifiable where its 95 % interval is narrow beside the number,
  and tied to another where the two can only be told apart with difficulty.
- An effect is identifiable where a much weaker one than usual would show beside everything that
  the nominal form leaves free. What an answer may leave unexplained counts as noise.
- Both rest on how rollouts change with a number at the refitted nominal form, so they hold near it.

Source: L. Ljung, System Identification (1999), chapters 8.2 and 13.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from trueup.canonical import Json
from trueup.cores import in_parallel
from trueup.diagnose.bounds import blind
from trueup.diagnose.data_quality import assess
from trueup.diagnose.explain import in_units, unit
from trueup.diagnose.explore import Progress, unexplored
from trueup.diagnose.intervals import inverse_information
from trueup.diagnose.problem_setup import Recordings
from trueup.diagnose.search_problem import SearchProblem
from trueup.diagnose.tuning_of_answers import EVIDENCE
from trueup.episode.episode import Episode
from trueup.fit.free_numbers import Directions, Free
from trueup.fit.rollout_fit import TWO_SIDED
from trueup.fit.screening import Screening
from trueup.model.block import joint, kind
from trueup.model.effect import label_of
from trueup.model.plant import Plant

Array = NDArray[np.float64]


class Shown(StrEnum):
    """How well recordings show something."""

    IDENTIFIABLE = "identifiable"
    WEAK = "weak"
    NOT = "not_identifiable"


@dataclass(frozen=True, slots=True)
class ParameterShown:
    """How well a number of the nominal form is shown: half of its 95 % interval over its size, and
    the numbers that it is tied to. `within` is infinite where nothing shows it."""

    parameter: str
    shown: Shown
    value: float
    within: float
    tied_to: tuple[str, ...]

    def document(self) -> dict[str, Json]:
        """It as JSON, a row of the report."""
        return {
            "parameter": self.parameter,
            "shown": str(self.shown),
            "value": self.value,
            "within": self.within if np.isfinite(self.within) else None,
            "tied_to": list(self.tied_to),
        }


@dataclass(frozen=True, slots=True)
class EffectShown:
    """How well an effect would be shown.

    ``weakest`` is the smallest size, by the first parameter of the effect, that the recordings
    tell from none; None where they would not show even a strong one. For an effect that limits,
    such as a saturation, it is the highest limit that shows."""

    effect: str
    joint: str | None
    shown: Shown
    parameter: str
    weakest: float | None
    unit: str
    tied_to: tuple[str, ...]
    why: str

    def document(self) -> dict[str, Json]:
        """It as JSON, a row of the report."""
        return {
            "effect": self.effect,
            **({"joint": self.joint} if self.joint else {}),
            "shown": str(self.shown),
            "parameter": self.parameter,
            "label": label_of(self.effect, self.parameter),
            "weakest": self.weakest,
            "unit": self.unit,
            "tied_to": list(self.tied_to),
            **({"why": self.why} if self.why else {}),
        }


@dataclass(frozen=True, slots=True)
class Identifiability:
    """What recordings can show: the numbers of the nominal form, and the effects."""

    parameters: Sequence[ParameterShown]
    effects: Sequence[EffectShown]

    def document(self) -> dict[str, Json]:
        """The table as JSON, a field of the report."""
        return {
            "parameters": [p.document() for p in self.parameters],
            "effects": [e.document() for e in self.effects],
        }


def identifiability_of(
    plant: Plant,
    episodes: Sequence[Episode],
    progress: Progress = lambda _stage, _part: None,
) -> Identifiability:
    """What episodes can show of a plant, without a search. Raises NotIdentifiable where there is no
    adaptation or no validation episode, or where the joint never moves."""
    recordings = Recordings.of(plant, episodes)
    quality = assess(plant, recordings.adaptation)
    return identifiability(recordings, unexplored(recordings, quality, progress).problem)


def identifiability(recordings: Recordings, problem: SearchProblem) -> Identifiability:
    """What the recordings of a search problem can show of its numbers and effects.

    Of the error that the nominal form leaves, the part that an answer may leave counts as noise.
    """
    plant, terms, base = recordings.plant, recordings.terms, problem.base
    near = problem.short_fit(base)
    excess = recordings.criteria.unexplained * max(near.fit.reduced_chi_square - 1.0, 0.0)
    noise = float(np.sqrt(1.0 + excess))
    shown = problem.shown_freely(near.fit, problem.short, near)
    return Identifiability(
        _parameters(plant, problem, noise),
        list(in_parallel(lambda t: _effect(plant, problem, t, shown(t), noise), terms)),
    )


def _parameters(plant: Plant, problem: SearchProblem, noise: float) -> list[ParameterShown]:
    base, directions = problem.base, problem.fitter.directions
    spread = noise**2 * inverse_information(base)
    along = spread[: len(directions.names), : len(directions.names)]
    widths = TWO_SIDED * np.sqrt(
        np.maximum(np.einsum("ai,ab,bi->i", directions.along, along, directions.along), 0.0)
    )
    ties = _ties(plant, directions, base.free, spread)
    rows = []
    for i, (name, nominal) in enumerate(plant.nominal.items()):
        value = float(base.values[i])
        size = max(abs(value), abs(nominal))
        shows = directions.determined[i] or i in directions.alone
        within = float(widths[i]) / size if shows and size > 0.0 else float("inf")
        rows.append(ParameterShown(name, _level(within), value, within, ties.get(name, ())))
    return rows


def _level(within: float) -> Shown:
    if within <= EVIDENCE.narrow:
        return Shown.IDENTIFIABLE
    return Shown.WEAK if within <= EVIDENCE.wide else Shown.NOT


def _ties(
    plant: Plant, directions: Directions, free: Free, spread: Array
) -> dict[str, tuple[str, ...]]:
    """The numbers that each number is hardly told apart from, by name: of numbers that move by
    themselves by their estimates, of a tree's others by the combinations that they are shown in."""
    deviation = np.sqrt(np.maximum(np.diag(spread), 1e-300))
    correlation = np.abs(spread / deviation[:, None] / deviation)
    names = [name for _, name in free.names]
    ties = {}
    for i in np.flatnonzero(free.rows >= 0):
        others = np.flatnonzero((correlation[i] > EVIDENCE.tied) & (free.rows >= 0))
        ties[names[i]] = tuple(names[j] for j in others if j != i)
    combined = directions.along[directions.alone < 0]
    length = np.linalg.norm(combined, axis=0)
    together = np.abs(combined.T @ combined) / np.maximum(np.outer(length, length), 1e-300)
    every = list(plant.nominal)
    for i in np.flatnonzero((length > 0.0) & ~directions.determined):
        others = np.flatnonzero(together[i] > EVIDENCE.tied)
        ties[every[i]] = tuple(every[j] for j in others if j != i)
    return ties


def _effect(
    plant: Plant, problem: SearchProblem, term: str, screened: Screening, noise: float
) -> EffectShown:
    effect, at = kind(term), joint(term)
    number = effect.params[0]
    starts = np.array([abs(s[0]) for s in effect.starts])
    starts = starts * problem.fitter.unit(term, number.scale) * in_units(number.scale, plant, at)
    hidden = EVIDENCE.bound_errors * screened.error * noise  # of a guess: a weaker one is not told
    seen = hidden < 1.0
    if effect.falls:
        weakest = float(starts[seen].max()) if seen.any() else None
        part = float(hidden.min())
    elif effect.grid_refined:  # it does not grow in proportion: a guess is told as it is, or not
        weakest = float(starts[seen].min()) if seen.any() else None
        part = float(hidden.min())
    else:  # from the smallest guess that shows: an effect need not grow in proportion
        visible = seen & (starts > 0.0)
        part = float(np.min(hidden[starts > 0.0]))
        weakest = None
        if visible.any():
            smallest = starts[visible].min()
            weakest = float(smallest * np.min(hidden[visible & (starts == smallest)]))
    like = int(np.argmin(hidden))
    ties: tuple[str, ...] = ()
    if screened.like[like] >= 0 and screened.correlation[like] > EVIDENCE.tied:
        ties = (problem.base.free.names[screened.like[like]][1],)
    level = Shown.NOT
    if weakest is not None:
        level = Shown.IDENTIFIABLE if part < EVIDENCE.plain else Shown.WEAK
    return EffectShown(
        effect.name,
        plant.joint_name(at) if plant.names_joints else None,
        level,
        number.name,
        weakest,
        unit(number.scale, plant, at),
        ties,
        "" if weakest is not None else blind(effect),
    )
