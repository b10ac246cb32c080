"""Ensemble: every model still in play, so that a command is safe only if it is safe for all.

Members differ in the numbers that are not known: within a spread about the declared ones, or as a
diagnosis left them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trueup.model.block import BLOCK, joint, kind
from trueup.model.corrected import Corrected
from trueup.model.hypothesis import Hypothesis, switches
from trueup.model.plant import Plant
from trueup.model.roll import roll
from trueup.model.series import Scheme, refined, unobserved

Array = NDArray[np.float64]
TWO_SIDED = 1.96  # standard deviations of a 95 % interval
NUDGE = 1e-4  # of a number's spread, for derivatives
LEAST = 1e-6  # of a number: a spread that rounding does not lose


@dataclass(frozen=True)
class Ensemble:
    """Models of one plant: `centre` `(rows,)`, the parameters of the central one, and for each
    unknown number its name, row and standard deviation."""

    plant: Plant
    hypothesis: Hypothesis
    scheme: Scheme
    centre: Array
    names: tuple[str, ...]
    rows: tuple[int, ...]
    spread: Array
    low: Array

    @staticmethod
    def prior(plant: Plant, spread: float) -> Ensemble:
        """The nominal model; the 95 % interval of each number is `spread` times the number, to
        either side."""
        centre = plant.block.nulls.copy()
        centre[: len(plant.parameters)] = plant.parameters
        chosen = [(i, n, v) for i, (n, v) in enumerate(plant.nominal.items()) if v != 0.0]
        sizes = np.array([spread * abs(v) / TWO_SIDED for _, _, v in chosen])
        rows = tuple(i for i, _, _ in chosen)
        return Ensemble(
            plant,
            Hypothesis(),
            refined(plant),
            centre,
            tuple(n for _, n, _ in chosen),
            rows,
            sizes,
            _floor(centre, rows),
        )

    @staticmethod
    def posterior(model: Corrected, report: Mapping[str, Any]) -> Ensemble:
        """A corrected model with the intervals that its diagnosis reports. Raises KeyError,
        TypeError, ValueError."""
        plant, centre = model.plant, np.array(model.values)
        names: list[str] = []
        rows: list[int] = []
        sizes: list[float] = []
        order = plant.dynamics.parameter_names
        for name, parameter in report["parameters"].items():
            names.append(name)
            rows.append(order.index(name))
            sizes.append(_deviation(parameter["ci95"]))
        # what rounds is in the noise
        smooth = Hypothesis(tuple(t for t in model.hypothesis.effects if not kind(t).counted))
        for term in smooth.effects:
            where = plant.joint_name(joint(term))
            entry = next(
                (
                    e
                    for e in report["effects"]
                    if (e["effect"], e.get("joint", where)) == (kind(term).name, where)
                ),
                None,
            )
            for number, row in plant.block.rows_of(term).items():
                estimate = entry["estimate"].get(number) if entry else None
                if estimate and estimate["value"]:
                    names.append(f"{plant.term_words(term)} {number}")
                    rows.append(row)
                    # the report's unit cancels out
                    sizes.append(
                        abs(_deviation(estimate["ci95"]) / estimate["value"] * centre[row])
                    )
        spread = np.maximum(np.array(sizes), LEAST * np.abs(centre[rows]))
        return Ensemble(
            plant,
            smooth,
            model.scheme,
            centre,
            tuple(names),
            tuple(rows),
            spread,
            _floor(centre, rows),
        )

    @staticmethod
    def alternatives(plant: Plant, report: Mapping[str, Any]) -> tuple[Ensemble, ...]:
        """The ensembles of the alternatives that a diagnosis could not tell from its answer, each
        as it was fitted. Raises KeyError, TypeError, ValueError."""
        left = report["evidence"].get("alternatives", [])
        return tuple(
            Ensemble.posterior(
                Corrected.restore(plant, {**a["model"], "gain": [], "nearest": None}, {}), a
            )
            for a in left
        )

    @property
    def effects(self) -> tuple[str, ...]:
        """The effects of the hypothesis, each with its joint where there are several."""
        return tuple(self.plant.term_words(t) for t in self.hypothesis.effects)

    def drawn(self, count: int, rng: np.random.Generator) -> Array:
        """Members `(rows, count)`, the centre first; no number changes its sign."""
        members = self.moved(
            np.repeat(self.centre[:, None], count, axis=1),
            rng.standard_normal((len(self.rows), count)),
        )
        members[:, 0] = self.centre
        return members

    def moved(self, members: Array, by: Array) -> Array:
        """Members `(rows, …)` with their unknown numbers moved by `by` `(numbers, …)` spreads; none
        changes its sign."""
        rows, wide = list(self.rows), (-1, *(1,) * (by.ndim - 1))
        sign = np.where(self.centre[rows] < 0.0, -1.0, 1.0).reshape(wide)
        moved = members.copy()
        moved[rows] = sign * np.maximum(
            sign * (members[rows] + self.spread.reshape(wide) * by), self.low.reshape(wide)
        )
        return moved

    def nudged(self, member: Array) -> Array:
        """A member `(rows,)`, and copies of it with one unknown number each increased a little,
        `(rows, 1 + numbers)`."""
        lanes = np.repeat(member[:, None], 1 + len(self.rows), axis=1)
        for lane, (row, size) in enumerate(zip(self.rows, self.spread, strict=True), 1):
            lanes[row, lane] += NUDGE * size
        return lanes

    def responses(self, members: Array, t_s: Array, command: Array, start: Array) -> Array:
        """States `(members, samples, 2 x joints)` of members `(rows, members)` under a command
        `(samples, joints)`, from one `start` `(2 x joints,)` or from one each, `(2 x joints,
        members)`.
        """
        plant, count = self.plant, members.shape[1]
        padded = np.concatenate(
            [members, np.repeat(members[:, :1], -count % BLOCK, axis=1)], axis=1
        )
        series = unobserved(self.scheme, t_s, command, plant.command_scales, plant.timestep_s)
        each = np.broadcast_to(start if start.ndim > 1 else start[:, None], (len(start), count))
        init = np.concatenate(
            [each, np.repeat(each[:, :1], padded.shape[1] - count, axis=1)], axis=1
        )[None]
        out = roll(series, plant.form, padded, switches(self.hypothesis, len(plant.joints)), init)
        return np.ascontiguousarray(np.moveaxis(out[:, :, :count], 2, 0))

    def fisher(
        self, member: Array, t_s: Array, command: Array, start: Array, noise: Array
    ) -> Array:
        """The Fisher information of a command about a member's unknown numbers, each in units of
        its own spread, `(numbers, numbers)`. `noise` `(observations,)` is the standard deviation of
        each observation's noise."""
        states = self.responses(self.nudged(member), t_s, command, start)[
            :, :, self.plant.state_columns
        ]
        moved = ((states[1:] - states[:1]) / NUDGE / noise).reshape(len(self.rows), -1)
        return np.asarray(moved @ moved.T)


@dataclass(frozen=True)
class InPlay:
    """The ensembles in play of one plant: of a diagnosis' answer, and of every alternative that is
    not ruled out."""

    ensembles: tuple[Ensemble, ...]

    def drawn(self, count: int, rng: np.random.Generator) -> tuple[Array, ...]:
        """Random members of each ensemble, `(rows, members)`, at least `count` together."""
        return tuple(e.drawn(-(-count // len(self.ensembles)), rng) for e in self.ensembles)

    def responses(
        self, members: tuple[Array, ...], t_s: Array, command: Array, start: Array
    ) -> Array:
        """States of the members of all ensembles, `(members, samples, 2 x joints)`."""
        return np.concatenate(
            [
                e.responses(m, t_s, command, start)
                for e, m in zip(self.ensembles, members, strict=True)
            ]
        )


def _deviation(interval: Any) -> float:
    return float(interval[1] - interval[0]) / (2.0 * TWO_SIDED)


def _floor(centre: Array, rows: tuple[int, ...] | list[int]) -> Array:
    return LEAST * np.abs(centre[list(rows)])
