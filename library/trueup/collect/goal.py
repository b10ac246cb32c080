"""Goal: what an excitation is for, and the value of any command for it.

A goal is to determine a model's numbers, or to separate two models. For numbers, the value is the
width of their intervals; for two models, the distance of their predictions in standard errors of
the noise, after the numbers and the start of the wrong one were fitted to the other. Sources: L.
Pronzato, Automatica 44 (2008), on optimal experiments; W. G. Hunter, A. M. Reiner, Technometrics 7
(1965), on designs for discriminating between rival models.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from trueup.canonical import Json
from trueup.collect.ensemble import NUDGE, TWO_SIDED, Ensemble
from trueup.model.rounding import rounded

Array = NDArray[np.float64]
Run = tuple[Array, Array]  # times `(samples,)` [s], and a command `(samples, joints)` at them
SINGULAR = 1e-12  # of a scaled information matrix
RANK = 1e-10
GIVEN_WAY, TRIES = 30, 6  # steps in which a rival's numbers are refitted, and lengths of each
DAMPED, MORE = 0.1, 4.0  # of a unit of information: the first damping, and how it grows and falls
GAIN = 1e-3  # of the distance: a step that brings less is the last
NOTHING = 1e-300


class Evaluation(ABC):
    """The value of commands for a goal."""

    @abstractmethod
    def document(self) -> dict[str, Json]:
        """The value as JSON."""

    @abstractmethod
    def rows(self) -> list[tuple[str, float]]:
        """The rows of a table: a name and a number each."""


class Goal(ABC):
    """What an excitation is for. Commands are `(samples, joints)` at `t_s` `(samples,)` [s]."""

    title: str

    @abstractmethod
    def value(self, t_s: Array, command: Array, above: float = -np.inf) -> float:
        """The value of a command, as a logarithm; minus infinity where it has none. Of a value that
        is not `above` a bound, only that is exact."""

    @abstractmethod
    def evaluate(self, runs: Sequence[Run]) -> Evaluation:
        """The mean value of commands, each with its times, in the goal's own figures."""


@dataclass(frozen=True, slots=True)
class Information(Evaluation):
    """The half-width of each unknown number's 95 % interval after an excitation, in its own
    unit."""

    rank: int
    condition: float
    half_widths: dict[str, float]

    @staticmethod
    def of(ensemble: Ensemble, fisher: Array) -> Information:
        """The half-widths from an information matrix on the numbers of an ensemble, each in units
        of its spread."""
        size = np.sqrt(np.maximum(np.diag(fisher), 1e-300))
        powers = np.linalg.eigvalsh(fisher / size[:, None] / size)
        rank = int((powers > RANK * max(powers[-1], 1e-300)).sum())
        wide = TWO_SIDED * widths(fisher) * ensemble.spread
        condition = float(np.sqrt(powers[-1] / powers[0])) if powers[0] > 0.0 else np.inf
        return Information(
            rank, condition, dict(zip(ensemble.names, map(float, wide), strict=True))
        )

    def document(self) -> dict[str, Json]:
        """The half-widths as JSON; null for a number that is not determined."""
        wide: dict[str, Json] = {
            n: w if np.isfinite(w) else None for n, w in self.half_widths.items()
        }
        return {
            "rank": self.rank,
            "condition": self.condition if np.isfinite(self.condition) else None,
            "half_widths": wide,
        }

    def rows(self) -> list[tuple[str, float]]:
        return [*self.half_widths.items(), ("rank", self.rank), ("condition", self.condition)]


@dataclass(frozen=True)
class IdentificationGoal(Goal):
    """To determine the numbers of an ensemble. The value is how much more information a command
    brings of the number that gains least than random ones bring.

    `judged` `(rows, members)` are the members that it is a mean over, `random` the widths of their
    numbers from a random excitation.
    """

    ensemble: Ensemble
    noise: Array
    start: Array
    judged: Array
    random: Array
    title = "Half-widths of 95 % intervals"

    @staticmethod
    def of(
        ensemble: Ensemble,
        noise: Array,
        start: Array,
        judged: Array,
        runs: Sequence[Run],
    ) -> IdentificationGoal:
        """The goal, compared with random `runs`; noise `(observations,)` is a standard
        deviation."""
        goal = IdentificationGoal(
            ensemble, noise, start, judged, np.ones((judged.shape[1], len(ensemble.rows)))
        )
        random = np.array([widths(goal._mean(m, runs)) for m in judged.T])
        return IdentificationGoal(
            ensemble, noise, start, judged, np.where(np.isfinite(random), random, 1.0)
        )

    def value(self, t_s: Array, command: Array, above: float = -np.inf) -> float:
        """The value for the number that gains least, on the mean over members."""
        ratios = [
            widths(self._fisher(m, t_s, command)) / by
            for m, by in zip(self.judged.T, self.random, strict=True)
        ]
        return -2.0 * float(rounded(np.mean(np.log(np.max(ratios, axis=1)))))

    def evaluate(self, runs: Sequence[Run]) -> Information:
        return Information.of(self.ensemble, self._mean(self.ensemble.centre, runs))

    def _mean(self, member: Array, runs: Sequence[Run]) -> Array:
        """The mean information of those commands under which the member does not run away,
        `(numbers, numbers)`."""
        finite = [f for t, u in runs if np.isfinite(f := self._fisher(member, t, u)).all()]
        return np.mean(finite, axis=0) if finite else np.zeros((len(self.ensemble.rows),) * 2)

    def _fisher(self, member: Array, t_s: Array, command: Array) -> Array:
        return self.ensemble.fisher(member, t_s, command, self.start, self.noise)


@dataclass(frozen=True, slots=True)
class Separation(Evaluation):
    """The distance of an answer's predictions from those of each of its alternatives, in standard
    errors over the whole experiment."""

    alternatives: tuple[tuple[str, ...], ...]
    standard_errors: tuple[float, ...]

    @property
    def least(self) -> float:
        """The distance from the nearest alternative."""
        return min(self.standard_errors)

    def document(self) -> dict[str, Json]:
        pairs = zip(self.alternatives, self.standard_errors, strict=True)
        return {"separation": [{"from": list(names), "standard_errors": x} for names, x in pairs]}

    def rows(self) -> list[tuple[str, float]]:
        return [
            (" + ".join(names), x)
            for names, x in zip(self.alternatives, self.standard_errors, strict=True)
        ]


@dataclass(frozen=True)
class SplittingGoal(Goal):
    """To separate a diagnosis' answer, the first of `ensembles`, from each of its alternatives,
    whichever is right."""

    ensembles: tuple[Ensemble, ...]
    noise: Array
    start: Array
    title = "Standard errors from the answer"

    def value(self, t_s: Array, command: Array, above: float = -np.inf) -> float:
        """The value for the alternative that is separated least."""
        least = np.inf
        for truth, rival in self._pairs():
            least = min(least, self._apart(truth, rival, t_s, command, float(np.exp(above))))
            if np.log(max(least, NOTHING)) <= above:
                break
        return float(np.log(max(least, NOTHING)))

    def evaluate(self, runs: Sequence[Run]) -> Separation:
        distances = np.mean(
            [[self._apart(t, r, t_s, u) for t, r in self._pairs()] for t_s, u in runs], axis=0
        )
        least = distances.reshape(-1, 2).min(axis=1)
        return Separation(tuple(e.effects for e in self.ensembles[1:]), tuple(map(float, least)))

    def _pairs(self) -> list[tuple[int, int]]:
        """The pairs of a true ensemble and its rival: for each alternative, both ways."""
        return list(
            chain.from_iterable(((0, other), (other, 0)) for other in range(1, len(self.ensembles)))
        )

    @np.errstate(over="ignore", invalid="ignore")  # what runs away is told at the end
    def _apart(
        self, truth: int, rival: int, t_s: Array, command: Array, enough: float = 0.0
    ) -> float:
        """The distance of the rival from the central model of `truth`, after the rival's numbers
        and start were fitted to it; once it is below `enough`, an upper bound of it.

        The steps are damped (Levenberg-Marquardt): a law's shape bends the way, and undamped steps
        stop far from its end. Where a model runs away nothing is known, and the distance is 0.
        """
        ensemble = self.ensembles[rival]
        seen = self._seen(truth, self.ensembles[truth].centre[:, None], t_s, command)[0]
        member, start, damping = ensemble.centre, self.start, DAMPED
        left = float(np.linalg.norm(seen - self._seen(rival, member[:, None], t_s, command)[0]))
        for _ in range(GIVEN_WAY):
            expected, columns = self._tangent(rival, member, start, t_s, command)
            size = np.linalg.norm(columns, axis=0) + NOTHING
            if not (np.isfinite(columns).all() and left > enough):
                break
            power, pull = (
                (columns / size).T @ (columns / size),
                (columns / size).T @ (seen - expected),
            )
            for _ in range(TRIES):
                by = rounded(np.linalg.solve(power + damping * np.eye(len(power)), pull) / size)
                moved = (
                    ensemble.moved(member, by[: len(ensemble.rows)]),
                    start + by[len(ensemble.rows) :] * self._unit(),
                )
                now = float(
                    np.linalg.norm(
                        seen - self._seen(rival, moved[0][:, None], t_s, command, moved[1])[0]
                    )
                )
                if now < left:
                    break
                damping *= MORE
            else:
                break
            gained, left, damping = left - now, now, damping / MORE
            member, start = moved
            if gained < GAIN * left:
                break
        # a wave that is better in its last bit is no better
        return float(rounded(left)) if np.isfinite(left) else 0.0

    def _tangent(
        self, which: int, member: Array, start: Array, t_s: Array, command: Array
    ) -> tuple[Array, Array]:
        """What a member predicts `(samples x observations,)`, and how that moves with each number
        and state of its start."""
        ensemble, unit = self.ensembles[which], self._unit()
        lanes = ensemble.nudged(member)
        lanes = np.concatenate([lanes, np.repeat(lanes[:, :1], len(unit), axis=1)], axis=1)
        starts = np.repeat(start[:, None], lanes.shape[1], axis=1)
        starts[:, -len(unit) :] += NUDGE * np.diag(unit)
        seen = self._seen(which, lanes, t_s, command, starts)
        return seen[0], ((seen[1:] - seen[0]) / NUDGE).T

    def _seen(
        self, which: int, members: Array, t_s: Array, command: Array, start: Array | None = None
    ) -> Array:
        """Observations of members in units of their noise, `(members, samples x observations)`."""
        ensemble = self.ensembles[which]
        states = ensemble.responses(members, t_s, command, self.start if start is None else start)
        return np.asarray(
            (states[:, :, ensemble.plant.state_columns] / self.noise).reshape(members.shape[1], -1)
        )

    def _unit(self) -> Array:
        """A size of each state, `(2 x joints,)`."""
        plant = self.ensembles[0].plant
        unit = np.full(2 * len(plant.joints), float(np.min(plant.scales)))
        unit[plant.state_columns] = plant.scales
        return unit


def widths(fisher: Array) -> Array:
    """Standard deviation of each number `(numbers,)` from an information matrix, infinite where it
    does not determine them all."""
    size = np.sqrt(np.maximum(np.diag(fisher), 1e-300))
    scaled = fisher / size[:, None] / size
    if not np.isfinite(scaled).all() or np.linalg.eigvalsh(scaled)[0] < SINGULAR:
        return np.full(len(size), np.inf)
    return np.asarray(np.sqrt(np.diag(np.linalg.inv(scaled))) / size)
