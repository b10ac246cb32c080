"""Between recordings: whether recordings of one machine agree on a number, and by how much they
differ where they do not.

A composition is fitted to the windows of each recording alone, from where the fit to all of them
ended. How uncertain such an estimate is, its own few windows cannot tell: it is as uncertain as its
information and what is left of its samples say, times what windows within recordings disagree by
more than that, over all recordings. Cochran's Q says whether estimates differ by more; where they
do, DerSimonian and Laird's variance between recordings says by how much. The interval of the answer
is then wider by Student's t of its root, for what one more recording may show, but by no more than
the recordings' own intervals reach.

Source: R. DerSimonian, N. Laird, Controlled Clinical Trials 7 (1986), for Q and the variance, here
with the F distribution, for the uncertainty is itself estimated; J. P. T. Higgins, S. G. Thompson,
D. J. Spiegelhalter, Journal of the Royal Statistical Society A 172 (2009), for what the next
recording may show.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc, fdtrc, stdtrit

from trueup.canonical import Json
from trueup.cores import in_parallel
from trueup.diagnose.explain import described, in_units, unit
from trueup.diagnose.intervals import (
    NOTHING,
    TAIL,
    WIDEST,
    Minima,
    Name,
    intervals,
    inverse_information,
)
from trueup.diagnose.tuning import SELECTION
from trueup.diagnose.tuning_of_answers import EVIDENCE
from trueup.diagnose.windowed_fits import WindowedFits
from trueup.episode.episode import Episode
from trueup.fit.base_parameters import COMBINATION
from trueup.fit.rollout_fit import TWO_SIDED, RolloutFit
from trueup.model.block import joint, kind
from trueup.model.plant import Plant
from trueup.model.series import Series

Array = NDArray[np.float64]
FEWEST = 2  # recordings that can differ


@dataclass(frozen=True, slots=True)
class Alone:
    """What one subset of the recordings says of a number: its estimate, and half of its 95 %
    interval."""

    value: float
    half: float

    @property
    def ends(self) -> tuple[float, float]:
        """The interval."""
        return self.value - self.half, self.value + self.half

    def document(self, factor: float) -> dict[str, Json]:
        """The estimate with its interval as JSON, in units of which one of the fit's is so many."""
        return {"value": factor * self.value, "ci95": [factor * end for end in self.ends]}


@dataclass(frozen=True)
class Difference:
    """What subsets of the recordings say of one number, by the subset's name. Their intervals rest
    on so many degrees of `freedom`."""

    estimates: Mapping[str, Alone]
    freedom: float = np.inf

    @cached_property
    def mean(self) -> float:
        """Their mean, each weighed by its own certainty."""
        return float(self._weights @ self._values / self._weights.sum())

    @cached_property
    def q(self) -> float:
        """Cochran's Q: the sum of squared distances from the mean in standard errors."""
        return float(self._weights @ (self._values - self.mean) ** 2)

    @property
    def p(self) -> float:
        """How probable it is that subsets which agree differ by so much."""
        others = len(self.estimates) - 1
        if np.isinf(self.freedom):
            return float(chdtrc(others, self.q))
        return float(fdtrc(others, self.freedom, self.q / others))

    @property
    def deviation(self) -> float:
        """Standard deviation between subsets, beyond their own uncertainty."""
        weights = self._weights
        scale = float(weights.sum() - np.square(weights).sum() / weights.sum())
        return float(np.sqrt(max(self.q - (len(weights) - 1), 0.0) / max(scale, 1e-300)))

    @property
    def differs(self) -> bool:
        """Whether they differ, so that an interval is wider for it."""
        return self.p < EVIDENCE.differs

    @property
    def contradicts(self) -> bool:
        """Whether they differ so plainly that they do not agree."""
        return self.p < EVIDENCE.contradicts

    @property
    def half(self) -> float:
        """By how much half of an interval is wider; 0 where they agree.

        Student's t of the deviation would hold one more recording's estimate. Of two or three
        recordings t is large whatever they show, so it is no more than the furthest end of an
        interval, among those narrower than the deviation, lies from the mean.
        """
        if not self.differs:
            return 0.0
        each = list(self.estimates.values())
        known = [e for e in each if e.half <= self.deviation] or each
        reach = max(abs(e.value - self.mean) + e.half for e in known)
        return min(students(len(each) - 1) * self.deviation, reach)

    @property
    def apart(self) -> tuple[str, str] | None:
        """The two subsets whose intervals lie furthest apart; None where all of them meet."""
        ends = {name: e.ends for name, e in self.estimates.items()}
        between = {
            (a, b): max(ends[a][0] - ends[b][1], ends[b][0] - ends[a][1])
            for a, b in combinations(ends, 2)
        }
        furthest = max(between, key=lambda pair: between[pair])
        return furthest if between[furthest] > 0.0 else None

    def document(self, factor: float) -> dict[str, Json]:
        """How they differ as JSON, in units of which one of the fit's is so many."""
        return {
            "p": self.p,
            "deviation": factor * self.deviation,
            "contradicts": self.contradicts,
            "apart": list(self.apart) if self.apart else None,
        }

    @cached_property
    def _values(self) -> Array:
        return np.array([e.value for e in self.estimates.values()])

    @cached_property
    def _weights(self) -> Array:
        return np.array([(self._students / e.half) ** 2 for e in self.estimates.values()])

    @property
    def _students(self) -> float:
        """Standard errors in half of an interval."""
        return students(self.freedom)


@dataclass(frozen=True)
class Excess:
    """How many times larger the variance of each number is than its information and what is left of
    a sample say, since errors of samples are correlated; estimated by so many degrees of
    `freedom`."""

    ratios: Mapping[Name, float]
    freedom: float

    @staticmethod
    def of(fit: RolloutFit) -> Excess:
        """By what windows of one recording disagree, over all recordings of a fit."""
        parts = [part - part.mean(axis=0) for part in fit.split(fit.scores).values()]
        windows, freedom = sum(map(len, parts)), sum(len(p) - 1 for p in parts)
        if fit.reduced_chi_square <= SELECTION.adequate or freedom < 1:
            return Excess(dict.fromkeys(fit.free.names, 1.0), np.inf)
        inverse = inverse_information(fit)
        moved = np.concatenate(parts) @ inverse
        by_windows = np.square(moved).sum(axis=0) * windows / freedom
        expected = np.diag(inverse) * max(fit.reduced_chi_square, 1.0)
        ratios = np.maximum(by_windows / np.maximum(expected, NOTHING), 1.0)
        return Excess(dict(zip(fit.free.names, map(float, ratios), strict=True)), float(freedom))

    def halves(self, fit: RolloutFit) -> dict[Name, float]:
        """Half of each 95 % interval of a fit to some of the recordings. One that ended further
        from its minimum than an interval is off by as much."""
        variances = np.maximum(np.diag(inverse_information(fit)), 0.0)
        variances = variances * max(fit.reduced_chi_square, 1.0)
        off = max(fit.distance or 0.0, 1.0) * students(self.freedom)
        return {
            name: off * float(np.sqrt(variance * self.ratios.get(name, 1.0)))
            for name, variance in zip(fit.free.names, variances, strict=True)
        }


def students(freedom: float) -> float:
    """Standard errors in half of a 95 % interval, by degrees of freedom."""
    return TWO_SIDED if np.isinf(freedom) else float(stdtrit(freedom, TAIL))


@dataclass(frozen=True)
class Agreement:
    """What subsets of the recordings say of each number that at least two of them determine, by
    (effect's term or "", parameter)."""

    by_number: Mapping[Name, Difference] = field(default_factory=dict)

    @staticmethod
    def of(together: RolloutFit, fitted: Mapping[str, RolloutFit]) -> Agreement:
        """What fits of one composition say, by the name of the subset that each was fitted to,
        beside the fit to all recordings `together`."""
        excess = Excess.of(together)
        estimates: dict[Name, dict[str, Alone]] = {}
        for subset, fit in fitted.items():
            steps = dict(zip(fit.free.names, fit.free.step, strict=True))
            halves = excess.halves(fit)
            for name, value in zip(fit.free.names, fit.free.at(fit.values), strict=True):
                half = halves[name]
                if np.isfinite(half) and 0.0 < half < WIDEST * steps[name]:
                    estimates.setdefault(name, {})[subset] = Alone(float(value), half)
        return Agreement(
            {
                name: Difference(e, excess.freedom)
                for name, e in estimates.items()
                if len(e) >= FEWEST
            }
        )

    @property
    def wider(self) -> dict[Name, float]:
        """By how much half of an interval grows, in quadrature, of the numbers that differ."""
        return {name: d.half for name, d in self.by_number.items() if d.differs}

    def document(self, plant: Plant, minima: Minima) -> list[Json]:
        """Each number, with what every recording says of it and what all say together without the
        difference, in the declared units, as JSON."""
        together, best = intervals(replace(minima, wider={})), minima.best
        values = dict(zip(best.free.names, best.free.at(best.values), strict=True))
        entries: list[Json] = []
        for name, difference in self.by_number.items():
            words, factor = named(plant, *name)
            low, high = together[name]
            entries.append(
                {
                    **words,
                    "value": factor * float(values[name]),
                    "together": [factor * low, factor * high],
                    **difference.document(factor),
                    "widens": difference.differs,
                    "recordings": [
                        {"sha256": recording, **e.document(factor)}
                        for recording, e in difference.estimates.items()
                    ],
                }
            )
        return entries


def named(plant: Plant, term: str, parameter: str) -> tuple[dict[str, Json], float]:
    """What a number is called, and how many of its declared units one of the fit's own is. A
    combination of a robot's inertial numbers has no unit, nor has a simulator's number."""
    if term:
        number = next(n for n in kind(term).params if n.name == parameter)
        at = joint(term)
        where: dict[str, Json] = {"joint": plant.joint_name(at)} if plant.names_joints else {}
        return {
            "effect": kind(term).name,
            **where,
            "parameter": parameter,
            "label": number.label,
            "unit": unit(number.scale, plant, at),
        }, in_units(number.scale, plant, at)
    is_sum = parameter.startswith(COMBINATION)
    label = f"{parameter} of inertial parameters and gains" if is_sum else parameter
    called = described(plant).get(parameter, {"label": label, "unit": ""})
    return {"effect": None, "parameter": parameter, **called}, 1.0


def agreement(episodes: Sequence[Episode], fits: WindowedFits, fit: RolloutFit) -> Agreement:
    """Whether the recordings of some episodes agree on the numbers of a fit to their windows. Parts
    of one recording stay together."""
    recording = {e.digest: e.recording for e in episodes}
    subsets: dict[str, list[Series]] = {}
    for s in fits.adaptation:
        subsets.setdefault(recording.get(s.digest, s.digest), []).append(s)
    return Agreement.of(fit, alone(fits, fit, subsets)) if len(subsets) >= FEWEST else Agreement()


def alone(
    fits: WindowedFits, fit: RolloutFit, subsets: Mapping[str, Sequence[Series]]
) -> dict[str, RolloutFit]:
    """A composition fitted to each subset of windows alone, from where `fit` ended; without those
    in which it runs away."""
    fitted = in_parallel(lambda data: fits.alone(data, fit), list(subsets.values()))
    return {name: f for name, f in zip(subsets, fitted, strict=True) if np.isfinite(f.cost)}
