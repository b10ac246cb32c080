"""Bounds: how large each effect that the answer lacks may be all the same, and which effects the
recordings could not have shown."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from trueup.canonical import Json
from trueup.cores import in_parallel
from trueup.diagnose.candidate import Candidate
from trueup.diagnose.explain import in_units, unit
from trueup.diagnose.model_selection import Choice
from trueup.diagnose.search import Search, has_already
from trueup.diagnose.tuning_of_answers import EVIDENCE
from trueup.fit.rollout_fit import RolloutFit
from trueup.fit.screening import Screening
from trueup.model.block import joint, kind
from trueup.model.effect import Effect, label_of
from trueup.model.plant import Plant


@dataclass(frozen=True, slots=True)
class Bound:
    """What the data say of one effect that was not found: how large it may be, or why they cannot
    tell."""

    effect: str
    joint: str | None
    parameter: str
    value: float | None
    falls: bool
    unit: str
    why: str

    def document(self) -> dict[str, Json]:
        """The bound as JSON, a field of the report."""
        named: dict[str, Json] = {
            "effect": self.effect,
            **({"joint": self.joint} if self.joint else {}),
        }
        if self.value is None:
            return {**named, "why": self.why}
        side = "above" if self.falls else "below"
        return {
            **named,
            "parameter": self.parameter,
            "label": label_of(self.effect, self.parameter),
            side: self.value,
            "unit": self.unit,
            "confidence": 0.95,
        }


def bounds(
    search: Search, choice: Choice, plant: Plant, alike: float
) -> tuple[list[Bound], list[Bound]]:
    """What the data say of each effect that neither the answer nor an alternative has: the bounds,
    and those without one, which say why.

    A bound holds beside every composition that was fitted with the effect and leaves no more than
    the answer does, or by the part `alike` more: their estimates lie within it.
    """
    named = [c.hypothesis for c in (choice.winner, *choice.rivals)]
    terms = [t for t in search.terms if not any(has_already(h, t) for h in named)]
    problem, fit = search.problem, choice.winner.fit
    data, near = problem.adaptation, None
    limit = (1.0 + alike) * choice.winner.total
    near_the_answer = [c for c in search if c.total <= limit]
    if problem.strategy.robot:  # where terms were screened is enough: every joint has its own
        near = problem.short_fit(fit)
        data, fit = problem.short, near.fit
    shown = problem.shown_freely(fit, data, near)
    alone = in_parallel(lambda t: _bound(search, shown(t), fit, t, plant), terms)
    every = [_beside(b, t, near_the_answer, plant) for t, b in zip(terms, alone, strict=True)]
    return [b for b in every if b.value is not None], [b for b in every if b.value is None]


def _beside(bound: Bound, term: str, candidates: Sequence[Candidate], plant: Plant) -> Bound:
    """A bound that holds the estimates of candidates, too."""
    row = plant.block.rows(term)[0]
    factor = in_units(kind(term).params[0].scale, plant, joint(term))
    sizes = [
        factor * abs(float(c.fit.values[row])) for c in candidates if term in c.hypothesis.effects
    ]
    if bound.value is None or not sizes:
        return bound
    widest = min if bound.falls else max
    return replace(bound, value=widest(bound.value, *sizes))


def _bound(search: Search, screened: Screening, fit: RolloutFit, term: str, plant: Plant) -> Bound:
    effect, fitter, at = kind(term), search.problem.fitter, joint(term)
    name, where = effect.name, plant.joint_name(at) if plant.names_joints else None
    error = EVIDENCE.bound_errors * screened.error * np.sqrt(max(fit.reduced_chi_square, 1.0))
    number = effect.params[0]
    factor = in_units(number.scale, plant, at)
    starts = np.array(
        [max(abs(s[0]), abs(s[1]) if effect.periodic else 0.0) for s in effect.starts]
    ) * fitter.unit(term, number.scale)
    measure = unit(number.scale, plant, at)
    if effect.falls:
        ruled_out = screened.factor + error < EVIDENCE.ruled_out
        order = np.argsort(starts)  # the strongest first
        last = int(np.argmin(np.append(ruled_out[order], False)))
        value = float(starts[order][last - 1]) * factor if last else None
        return Bound(name, where, number.name, value, True, measure, "" if last else blind(effect))
    limits = (np.abs(screened.factor) + error) * starts
    if (
        effect.grid_refined
    ):  # small ones do not grow in proportion: what would have been seen whole bounds
        limits = np.where(limits < starts, starts, np.inf)
    shapes: dict[tuple[float, ...], float] = {}
    for s, limit, start in zip(effect.starts, limits, starts, strict=True):
        if start > 0.0:  # the others have none of the number that is bounded
            shape = s if effect.periodic else s[1:]
            shapes[shape] = min(
                shapes.get(shape, np.inf),
                limit if limit <= EVIDENCE.linear_reach * start else np.inf,
            )
    # of the shapes that would have shown
    sound = [limit for limit in shapes.values() if np.isfinite(limit)]
    if not sound:
        return Bound(name, where, number.name, None, False, measure, blind(effect))
    return Bound(name, where, number.name, float(max(sound)) * factor, False, measure, "")


def blind(effect: type[Effect]) -> str:
    """The effect's own word on the data that cannot show it."""
    text = (effect.__doc__ or "").split("Blind:")[-1]
    return " ".join(text.split())
