"""Randomisation: a family of plants as data, from which plants are drawn.

    {"schema": "trueup.randomisation/1",
     "numbers": [{"number": "k", "distribution": "uniform", "low": 0.6, "high": 1.6},
                 {"number": "coulomb_friction.level", "distribution": "lognorm", "s": 0.5}],
     "correlation": [["k", "b", 0.6]]}

Numbers are drawn in their order, so they are a list: a JSON object has none. A number is a
parameter of the nominal model, or `EFFECT.NUMBER` of the catalogue, with the joint of
a robot as `EFFECT@JOINT.NUMBER`. Numbers are independent unless `correlation` ties them by a
Gaussian copula: their ranks are correlated, their distributions stay. Several `numbers` with
weights under `mixture` are one family of several kinds of plants; a number that a kind does not
name has its nominal value there, and an effect that it does not name does not act.
Source of the copula: A. Sklar, Publ. Inst. Statist. Univ. Paris 8 (1959); R. B. Nelsen, An
Introduction to Copulas (2006), section 2.9.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, stats

from trueup.canonical import Json, digest_of
from trueup.errors import BadPlant, BadRandomisation
from trueup.model.block import term
from trueup.model.corrected import Corrected
from trueup.model.effect import effects
from trueup.model.fields import Reader
from trueup.model.hypothesis import Hypothesis
from trueup.model.plant import Plant
from trueup.model.predictor import Identified, Predictor
from trueup.model.series import DECLARED
from trueup.randomise.marginal import Marginal
from trueup.randomise.membership import Box

Array = NDArray[np.float64]
SCHEMA = "trueup.randomisation/1"
MASS = 0.99  # of the draws that an unbounded number's box holds
MOST_NUMBERS, MOST_KINDS = 200, 32


@dataclass(frozen=True)
class Kind:
    """One kind of plant of a family: its weight, the marginal of each number, and the correlation
    of their normal scores `(numbers, numbers)`, None where they are independent."""

    weight: float
    marginals: Mapping[str, Marginal]
    correlation: Array | None

    def draw(self, rng: np.random.Generator) -> dict[str, float]:
        """The numbers of one plant, drawn in their order."""
        if self.correlation is None:
            return {name: m.draw(rng) for name, m in self.marginals.items()}
        scores = stats.multivariate_normal(cov=self.correlation, allow_singular=True)
        ranks = stats.norm.cdf(np.atleast_1d(scores.rvs(random_state=rng)))
        pairs = zip(self.marginals.items(), ranks, strict=True)
        return {name: m.quantile(float(rank)) for (name, m), rank in pairs}


@dataclass(frozen=True)
class Randomisation:
    """A family of plants around `plant`, of one or several kinds; `document` is what it was read
    from."""

    plant: Plant
    kinds: tuple[Kind, ...]
    document: Mapping[str, Json]

    @staticmethod
    def of(plant: Plant, document: object) -> Randomisation:
        """The family that a document describes. Raises BadRandomisation at the field that breaks a
        rule."""
        try:
            root = Reader.of(document)
            root.choice("schema", [SCHEMA], default=SCHEMA)
            if "mixture" in root.value:
                root.no_more("schema", "mixture", "because")
                kinds = tuple(_kind(plant, k, weighted=True) for k in root.children("mixture"))
            else:
                root.no_more("schema", "numbers", "correlation", "because")
                kinds = (_kind(plant, root, weighted=False),)
        except BadPlant as error:  # of the reader, which plant.json shares
            raise BadRandomisation(error.message, field=error.facts.get("field")) from error
        if not 0 < len(kinds) <= MOST_KINDS:
            raise BadRandomisation(f"a mixture has 1 to {MOST_KINDS} kinds", field="mixture")
        return Randomisation(plant, kinds, root.value)

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the canonical document."""
        return digest_of(self.document)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Every number that some kind names, in order."""
        return tuple(dict.fromkeys(name for kind in self.kinds for name in kind.marginals))

    def draw(self, rng: np.random.Generator) -> dict[str, float]:
        """The numbers of one plant, those of its kind alone."""
        if len(self.kinds) == 1:
            return self.kinds[0].draw(rng)
        weights = np.array([kind.weight for kind in self.kinds])
        return self.kinds[rng.choice(len(weights), p=weights / weights.sum())].draw(rng)

    def box(self, mass: float = MASS) -> Box:
        """The declared range of each number over all kinds, with its value where a kind does not
        name it."""
        ranges: dict[str, tuple[float, float]] = {}
        for name in self.names:
            ends = [
                kind.marginals[name].box(mass)
                if name in kind.marginals
                else (self.usual(name),) * 2
                for kind in self.kinds
            ]
            ranges[name] = min(e[0] for e in ends), max(e[1] for e in ends)
        return ranges

    def usual(self, name: str) -> float:
        """A number's value where nothing is said of it: nominal, or that at which its effect
        vanishes."""
        of, row = _row(self.plant, name)
        return self.plant.nominal[name] if of is None else float(self.plant.block.nulls[row])

    def model(self, values: Mapping[str, float]) -> Predictor:
        """The plant with these numbers, as a predictor."""
        plant, hypothesis = self.plant, Hypothesis()
        rows = plant.block.nulls.copy()
        rows[: len(plant.parameters)] = plant.parameters
        for name, value in values.items():
            of, row = _row(plant, name)
            rows[row] = value
            hypothesis = hypothesis if of is None else hypothesis | of
        if not hypothesis.effects:
            return Identified(plant, tuple(map(float, rows[: len(plant.parameters)])))
        return Corrected(plant, hypothesis, tuple(map(float, rows)), DECLARED)


def _kind(plant: Plant, reader: Reader, *, weighted: bool) -> Kind:
    weight = reader.number("weight", above=0.0) if weighted else 1.0
    if weighted:
        reader.no_more("weight", "numbers", "correlation", "because")
    numbers = reader.children("numbers")
    if len(numbers) > MOST_NUMBERS:
        raise BadRandomisation(
            f"a family varies {MOST_NUMBERS} numbers at most", field=reader.at("numbers")
        )
    marginals: dict[str, Marginal] = {}
    for number in numbers:
        name = number.text("number")
        _require_known(plant, name, number.at("number"))
        if name in marginals:
            raise BadRandomisation(f"{name} is named twice", field=number.at("number"))
        marginals[name] = Marginal.read(number)
    return Kind(weight, marginals, _correlation(list(marginals), reader))


def _correlation(names: Sequence[str], reader: Reader) -> Array | None:
    """The correlation of normal scores, None where none is given. Raises BadRandomisation where it
    is none."""
    given: Any = reader.value.get("correlation")
    if given is None:
        return None
    field = reader.at("correlation")
    matrix = np.eye(len(names))
    for entry in given if isinstance(given, list) else [None]:
        if not (isinstance(entry, list) and len(entry) == 3):  # noqa: PLR2004  (two names and a number)
            raise BadRandomisation("a correlation is [number, number, value]", field=field)
        first, second, value = entry
        known = first in names and second in names and first != second
        numeric = isinstance(value, int | float) and not isinstance(value, bool)
        if not known or not numeric or not -1.0 <= value <= 1.0:
            raise BadRandomisation(
                f"{entry} ties no two numbers of the family by a value from -1 to 1", field=field
            )
        i, j = names.index(first), names.index(second)
        matrix[i, j] = matrix[j, i] = float(value)
    if linalg.eigvalsh(matrix)[0] < -1e-9:  # noqa: PLR2004  (rounding of a singular matrix)
        raise BadRandomisation(
            "no numbers can be correlated so: the matrix is not positive semidefinite", field=field
        )
    return matrix


def _row(plant: Plant, name: str) -> tuple[str | None, int]:
    """The term of a number, None of a parameter, and its row in the plant's block. Raises KeyError
    or ValueError for an unknown one."""
    if name in plant.nominal:
        return None, plant.dynamics.parameter_names.index(name)
    of, _, number = name.rpartition(".")
    effect, _, at = of.partition("@")
    joint = [plant.joint_name(j) for j in range(len(plant.joints))].index(at) if at else 0
    if effect not in effects() or (not at and plant.names_joints):
        raise KeyError(name)
    acting = term(effect, joint)
    return acting, plant.block.rows_of(acting)[number]


def _require_known(plant: Plant, name: str, field: str) -> None:
    try:
        _row(plant, name)
    except (KeyError, ValueError):
        joint = "@JOINT" if plant.names_joints else ""
        raise BadRandomisation(
            f"{name!r} is neither a parameter of {plant.name} nor a number of an effect",
            field=field,
            hint=f"Parameters are {', '.join(plant.nominal)}; an effect's number is written "
            f"EFFECT{joint}.NUMBER, such as coulomb_friction{joint}.level.",
        ) from None
