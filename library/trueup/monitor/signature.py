"""Signatures: what each effect of the catalogue would do to the residuals, if it began to act.

From every window's start the model is rolled out once as it serves, and once for each effect and
parameter with a little more of it. The correlation of the residuals with the difference indicates
that effect long before the residuals' size does: noise is like no signature. Source: G. L. Turin,
IRE Transactions on Information Theory 6 (1960), on matched filters.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trueup.canonical import Json
from trueup.episode.episode import Episode
from trueup.model.block import BLOCK, joint, term
from trueup.model.corrected import Corrected
from trueup.model.effect import NULL, effects
from trueup.model.hypothesis import Hypothesis, Scales, begun, switches
from trueup.model.plant import Plant
from trueup.model.predictor import Physical, Predictor
from trueup.model.roll import roll
from trueup.model.series import DECLARED, Scheme, whole
from trueup.model.sizes import sizes_of
from trueup.model.state import past_states
from trueup.monitor.residuals import Healthy, Residuals, UnscaledResiduals

Array = NDArray[np.float64]
SHAPES = 4  # of each effect's starts: thresholds at several places have different signatures
STEP = 0.1  # of a parameter


@dataclass(frozen=True, slots=True)
class Sign:
    """One signature: of a term with a start in units of its scales, or, without a start, of the
    parameter of that name."""

    of: str
    start: tuple[float, ...] = ()


@dataclass(frozen=True)
class Signatures:
    """Which signatures are looked for, and the joints' sizes that their starts are measured in."""

    signs: tuple[Sign, ...]
    scales: tuple[Scales, ...]

    @staticmethod
    def of(plant: Plant, reference: Sequence[Episode]) -> Signatures:
        """Every effect at every joint that a log cannot show by itself, and a family's own
        parameters."""
        joints = len(plant.joints)
        shown = [e for e in effects().values() if not e.counted and not e.grid_refined]
        signs = [
            Sign(term(e.name, j), s)
            for j in range(joints)
            for e in shown
            for s in _shapes(e.starts, SHAPES if joints == 1 else 1)
        ]
        if plant.dynamics.has_own_numbers:
            signs += [Sign(name) for name, value in plant.nominal.items() if value]
        return Signatures(tuple(signs), sizes_of(plant, reference))

    def evidence(
        self,
        predictor: Predictor,
        episode: Episode,
        of: UnscaledResiduals,
        healthy: Healthy,
        residuals: Residuals,
    ) -> Residuals:
        """The residuals with their correlation to each signature."""
        plant = predictor.plant
        base, hypothesis, scheme = _base(predictor)
        lanes = [base, *(self._lane(plant, base, hypothesis, i) for i in range(len(self.signs)))]
        block = np.stack(lanes + [base] * (-len(lanes) % BLOCK), axis=1)
        for sign in self.signs:
            hypothesis = hypothesis | sign.of if sign.start else hypothesis
        series = whole(plant, episode, scheme, of.first)
        init = np.repeat(
            np.nan_to_num(past_states(plant, episode)[of.first])[:, :, None], block.shape[1], axis=2
        )
        with np.errstate(over="ignore", invalid="ignore"):
            out = roll(series, plant.form, block, switches(hypothesis, len(plant.joints)), init)[
                :, plant.state_columns
            ]
            moved = (out[of.rows, :, 1 : len(lanes)] - out[of.rows, :, :1]) / (
                plant.scales * healthy.at(of)
            )[:, :, None]
            sound = np.isfinite(moved).all(axis=(0, 1)) & (
                np.abs(moved).max(axis=(0, 1), initial=0.0) < np.sqrt(np.finfo(float).max)
            )
        moved = np.where(sound & (np.isfinite(of.values))[:, :, None], moved, 0.0)
        weighted = moved * residuals.weight[:, None, None]
        common = -np.einsum("icl,ic->il", weighted, residuals.values)
        power = np.einsum("icl,icl->il", weighted, moved)
        starts = np.flatnonzero(np.diff(of.window, prepend=-1))
        return replace(
            residuals,
            evidence=np.stack([np.add.reduceat(x, starts) for x in (common, power)], axis=2),
        )

    def _lane(self, plant: Plant, base: Array, acting: Hypothesis, index: int) -> Array:
        """The model with a little more of one sign: begun where the effect does not act yet, else
        one of its numbers grown."""
        sign = self.signs[index]
        if sign.start and sign.of not in acting.effects:
            return begun(plant.block, base, self.scales[joint(sign.of)], sign.of, sign.start)
        shape = index - [s.of for s in self.signs].index(sign.of)
        rows = (
            plant.block.rows(sign.of)
            if sign.start
            else (plant.dynamics.parameter_names.index(sign.of),)
        )
        values = base.copy()
        values[rows[shape % len(rows)]] *= 1.0 + STEP
        return values

    def names(self, plant: Plant) -> list[str]:
        """What each signature is of, in words: an effect, with its joint where there are several,
        or a parameter."""
        return [plant.term_words(s.of) if s.start else f"parameter {s.of}" for s in self.signs]

    def document(self) -> dict[str, Json]:
        """The signatures as JSON; a start at an effect's null value is null."""
        return {
            "signs": [
                {"of": s.of, "start": [None if np.isnan(x) else x for x in s.start]}
                for s in self.signs
            ],
            "scales": [
                [s.position, s.velocity, s.acceleration, s.command, s.error] for s in self.scales
            ],
        }

    @staticmethod
    def from_document(document: Any) -> Signatures:
        """Read what `document` returned. Raises KeyError, TypeError, ValueError."""
        signs = tuple(
            Sign(s["of"], tuple(NULL if x is None else float(x) for x in s["start"]))
            for s in document["signs"]
        )
        return Signatures(
            signs, tuple(Scales(*map(float, numbers)) for numbers in document["scales"])
        )


def _base(predictor: Predictor) -> tuple[Array, Hypothesis, Scheme]:
    """The model that signatures are differences from: the predictor itself where it is a form with
    numbers, else the plant's own."""
    if isinstance(predictor, Corrected):
        return np.array(predictor.values), predictor.hypothesis, predictor.scheme
    plant, values = predictor.plant, predictor.plant.block.nulls.copy()
    parameters = predictor.parameters if isinstance(predictor, Physical) else plant.parameters
    values[: len(parameters)] = parameters
    return values, Hypothesis(), DECLARED


def _shapes(starts: Sequence[tuple[float, ...]], most: int) -> list[tuple[float, ...]]:
    """Some of the starts, from the first to the last; of two that differ in the sign alone the
    first."""
    distinct: list[tuple[float, ...]] = []
    for start in starts:
        if tuple(-x for x in start) not in distinct:
            distinct.append(start)
    return (
        [
            distinct[i]
            for i in np.unique(np.linspace(0, len(distinct) - 1, most).round().astype(int))
        ]
        if most > 1
        else [distinct[len(distinct) // 3]]
    )
