"""Goal: what an excitation is for, to tell a model's numbers or to tell two models apart, and what
any command is worth for it.

Of numbers that is the width of their intervals; of two models the distance of what they predict, in
standard errors of the noise, once the numbers and the start of the wrong one have given way to it.
Sources: L. Pronzato, Automatica 44 (2008), on optimal experiments; W. G. Hunter, A. M. Reiner,
Technometrics 7 (1965), on designs for discriminating between rival models.
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
SINGULAR = 1e-12  # of a scaled information matrix
RANK = 1e-10
GIVEN_WAY, TRIES = 30, 6  # steps in which a rival's numbers are refitted, and lengths of each
DAMPED, MORE = 0.1, 4.0  # of a unit of information: the first damping, and how it grows and falls
GAIN = 1e-3  # of the distance: a step that brings less is the last
NOTHING = 1e-300


class Told(ABC):
    """What commands tell."""

    @abstractmethod
    def document(self) -> dict[str, Json]:
        """The same as JSON."""

    @abstractmethod
    def rows(self) -> list[tuple[str, float]]:
        """The same for a table: what, and how much."""


class Goal(ABC):
    """What an excitation is for. Commands are `(samples, joints)` at `t_s` `(samples,)` [s]."""

    title: str

    @abstractmethod
    def value(self, t_s: Array, command: Array, above: float = -np.inf) -> float:
        """How good a command is, as a logarithm; minus infinity where it tells nothing. Once it is
        known not to be `above` something, any value that is not is as good.
        """

    @abstractmethod
    def told(self, t_s: Array, commands: Sequence[Array]) -> Told:
        """What commands tell, on the mean."""


@dataclass(frozen=True, slots=True)
class Information(Told):
    """What an excitation would tell of each unknown number: the half-width of its 95 % interval, in
    its own unit."""

    rank: int
    condition: float
    half_widths: dict[str, float]

    @staticmethod
    def of(ensemble: Ensemble, fisher: Array) -> Information:
        """From an information matrix on the numbers of an ensemble, each in units of its spread."""
        size = np.sqrt(np.maximum(np.diag(fisher), 1e-300))
        powers = np.linalg.eigvalsh(fisher / size[:, None] / size)
        rank = int((powers > RANK * max(powers[-1], 1e-300)).sum())
        wide = TWO_SIDED * widths(fisher) * ensemble.spread
        condition = float(np.sqrt(powers[-1] / powers[0])) if powers[0] > 0.0 else np.inf
        return Information(
            rank, condition, dict(zip(ensemble.names, map(float, wide), strict=True))
        )

    def document(self) -> dict[str, Json]:
        """The same as JSON; what is not determined is null."""
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
class Identification(Goal):
    """To tell the numbers of an ensemble: how many times fewer samples than a random one a command
    needs.

    `judged` `(rows, members)` are those it is a mean over, `random` their numbers' widths from one
    sample of a random excitation.
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
        t_s: Array,
        commands: Sequence[Array],
    ) -> Identification:
        """Beside the random `commands`; noise `(observations,)` is a standard deviation."""
        goal = Identification(
            ensemble, noise, start, judged, np.ones((judged.shape[1], len(ensemble.rows)))
        )
        random = np.array([widths(goal._mean(m, t_s, commands) / len(t_s)) for m in judged.T])
        return Identification(
            ensemble, noise, start, judged, np.where(np.isfinite(random), random, 1.0)
        )

    def value(self, t_s: Array, command: Array, above: float = -np.inf) -> float:
        """For the number that gains least, on the mean over members."""
        ratios = [
            widths(self._fisher(m, t_s, command) / len(t_s)) / by
            for m, by in zip(self.judged.T, self.random, strict=True)
        ]
        return -2.0 * float(rounded(np.mean(np.log(np.max(ratios, axis=1)))))

    def told(self, t_s: Array, commands: Sequence[Array]) -> Information:
        return Information.of(self.ensemble, self._mean(self.ensemble.centre, t_s, commands))

    def _mean(self, member: Array, t_s: Array, commands: Sequence[Array]) -> Array:
        """The mean information of those commands under which the member does not run away,
        `(numbers, numbers)`."""
        found = [f for u in commands if np.isfinite(f := self._fisher(member, t_s, u)).all()]
        return np.mean(found, axis=0) if found else np.zeros((len(self.ensemble.rows),) * 2)

    def _fisher(self, member: Array, t_s: Array, command: Array) -> Array:
        return self.ensemble.fisher(member, t_s, command, self.start, self.noise)


@dataclass(frozen=True, slots=True)
class Separation(Told):
    """How far the predictions of an answer are from those of each of its alternatives, in standard
    errors over the whole experiment."""

    alternatives: tuple[tuple[str, ...], ...]
    standard_errors: tuple[float, ...]

    @property
    def least(self) -> float:
        """That of the alternative which is told worst."""
        return min(self.standard_errors)

    def document(self) -> dict[str, Json]:
        told = zip(self.alternatives, self.standard_errors, strict=True)
        return {"separation": [{"from": list(names), "standard_errors": x} for names, x in told]}

    def rows(self) -> list[tuple[str, float]]:
        return [
            (" + ".join(names), x)
            for names, x in zip(self.alternatives, self.standard_errors, strict=True)
        ]


@dataclass(frozen=True)
class Splitting(Goal):
    """To tell a diagnosis' answer, the first of `ensembles`, from each of its alternatives,
    whichever is right."""

    ensembles: tuple[Ensemble, ...]
    noise: Array
    start: Array
    title = "Standard errors from the answer"

    def value(self, t_s: Array, command: Array, above: float = -np.inf) -> float:
        """Of the alternative that is told worst."""
        least = np.inf
        for truth, rival in self._pairs():
            least = min(least, self._apart(truth, rival, t_s, command, float(np.exp(above))))
            if np.log(max(least, NOTHING)) <= above:
                break
        return float(np.log(max(least, NOTHING)))

    def told(self, t_s: Array, commands: Sequence[Array]) -> Separation:
        found = np.mean(
            [[self._apart(t, r, t_s, u) for t, r in self._pairs()] for u in commands], axis=0
        )
        least = found.reshape(-1, 2).min(axis=1)
        return Separation(tuple(e.effects for e in self.ensembles[1:]), tuple(map(float, least)))

    def _pairs(self) -> list[tuple[int, int]]:
        """Which may be the truth, and which is then the rival: for each alternative both."""
        return list(
            chain.from_iterable(((0, other), (other, 0)) for other in range(1, len(self.ensembles)))
        )

    @np.errstate(over="ignore", invalid="ignore")  # what runs away is told at the end
    def _apart(
        self, truth: int, rival: int, t_s: Array, command: Array, enough: float = 0.0
    ) -> float:
        """The distance from the central model of one, after the other's numbers and start were
        fitted to it; or one that is `enough`.

        Levenberg's and Marquardt's steps: the shape of a law bends the way, and undamped ones stop
        far from its end. Where a model runs away nothing is known, and the distance is none.
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
        return (
            float(rounded(left)) if np.isfinite(left) else 0.0
        )  # a wave that is better in its last bit is no better

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
