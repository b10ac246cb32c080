"""Problem: one plant's episodes, cut into windows under one scheme of integration, and the fits of
single compositions to them.

What a method answers depends on the problem and its arguments alone, so that whoever has the
episodes may ask it. Fits see adaptation episodes alone; compositions are compared on validation
episodes, where nothing but the windows' starts is estimated.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from trueup.fit.convergence import converge, minima
from trueup.fit.rollout_fit import Fitter, Linear, RolloutFit, Start
from trueup.model.block import BLOCK, Memory, kind
from trueup.model.hypothesis import Hypothesis, switches
from trueup.model.series import Scheme, Series, roll

GLANCE = 2  # iterations after which half of the starts are left
RACE = 6  # iterations that each start of a fit is given before the best go on
SETTLE = 16  # iterations of the best
Begin = tuple[Sequence[float], Sequence[float]]  # of the family's parameters, of the effect's
RACED = 3  # starts that are tried; twice as many of an effect with many
FAR = 50  # starts are neighbours within so many-th of all
MANY = 50
KEPT = 2  # starts that go on
SAME_PLACE, SAME_COST = 0.02, 1e-3  # of a value, of a cost: nearer fits are one
ZOOMS = (0.04, 0.013, 0.004, 0.0013)  # of a value: grids around the best, ever finer
ZOOM_POINTS = (-1.0, -0.66, -0.33, 0.33, 0.66, 1.0)
RESOLUTION = (
    2.0 * ZOOMS[-1]
)  # of a value that was zoomed in on: between corners that far apart the error is flat
ASKED_FOR = 18.0  # squared standard errors that a number must be worth
PASTS = (
    0.0,
    *(sign * x for x in (0.03, 0.07, 0.12, 0.18, 0.25, 0.35, 0.5) for sign in (1.0, -1.0)),
)  # of a memory's scale
ROBOT_STEPS = 8  # towards a minimum, of a robot's fit
CHECK = 10  # iterations for the starts of validation windows


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """A fitted composition, and how it does on validation episodes; not `resolved` is one with an
    effect as small as integration's own.

    `others` are minima that the data do not tell from the fit's, where it was taken to one.
    """

    fit: RolloutFit
    check: RolloutFit
    resolved: bool = True
    others: tuple[RolloutFit, ...] = ()

    @property
    def minima(self) -> tuple[RolloutFit, ...]:
        """Every minimum, its own the first."""
        return self.fit, *self.others

    @property
    def hypothesis(self) -> Hypothesis:
        """What acts."""
        return self.fit.hypothesis

    @property
    def misfit(self) -> float:
        """Mean squared normalised error on validation episodes."""
        return self.check.misfit


@dataclass(frozen=True, slots=True)
class Near:
    """A parent on short windows: its fit there, the derivatives that its extensions may keep, and
    the cost that a linear model expects of each start of a term.
    """

    parent: RolloutFit
    fit: RolloutFit
    linear: Linear | None
    expected: dict[str, np.ndarray]


@dataclass(eq=False)
class Problem:
    """What is fitted to what; it remembers nothing but the fits on short windows of its parents,
    `_near`."""

    fitter: Fitter
    adaptation: Sequence[Series]
    validation: Sequence[Series]
    short: Sequence[Series]
    length_s: float = 0.0  # of its windows
    base: RolloutFit | None = None  # the nominal form refitted
    pitches: Mapping[str, Sequence[Begin]] = field(
        default_factory=dict
    )  # of terms that repeat with the position
    evident: Sequence[
        str
    ] = ()  # terms that something else speaks for, so that they race in any case
    declared: Sequence[float] = ()  # numbers of a robot's nominal form, from which terms begin too
    pieces: Mapping[str, Series] = field(
        default_factory=dict
    )  # of a robot's windows, by episode digest: where their starts are found
    exact: bool = (
        True  # whether laws hold so well that a fit to a millionth of its cost tells anything
    )
    _near: dict[Hypothesis, Near] = field(default_factory=dict)

    @property
    def scheme(self) -> Scheme:
        """How it is integrated."""
        return self.adaptation[0].scheme

    def refitted(self, begins: Sequence[Sequence[float]]) -> Candidate:
        """The nominal form with the numbers that fit best, from the most promising of several
        beginnings."""
        fit, tried = (
            partial(self.fitter.fit, self.adaptation, Hypothesis()),
            [self.fitter.begin(b) for b in begins],
        )
        if len(tried) > 1:
            tried = [min((fit(b, iterations=GLANCE) for b in tried), key=lambda f: f.cost).values]
        return self.candidate(fit(tried[0], iterations=25))

    def nominal(self, parameters: Sequence[float]) -> RolloutFit:
        """The nominal parameters, on validation episodes."""
        return self.fitter.started(
            self.validation, Hypothesis(), self.fitter.begin(parameters), iterations=CHECK
        )

    def near(self, parent: RolloutFit) -> Near:
        """A fit on short windows."""
        known = self._near.get(parent.hypothesis)
        if known is None or not _begins_alike(known.parent, parent):
            fit = self.fitter.started(
                self.short,
                parent.hypothesis,
                parent.values,
                _remembering(self.short, parent),
                iterations=2,
            )
            known = self._near[parent.hypothesis] = Near(
                parent, fit, self.fitter.linear(self.short, fit), {}
            )
        return known

    def race(self, parent: RolloutFit, name: str, expected: np.ndarray) -> list[RolloutFit]:
        """Short fits of a composition with one term more from several starts: those that go on, the
        best first.

        `expected` is the cost that a linear model expects of each of the term's starts.
        """
        begins, near = self._begins(parent, name, expected), self.near(parent)
        resting, hypothesis = self.resting(begins[0], [name]), parent.hypothesis | name
        fit = partial(
            self.fitter.fit,
            self.short,
            hypothesis,
            starts=_remembering(self.short, near.fit),
            fixed=resting,
            linear=near.linear,
        )
        if self.exact and len(
            self.declared
        ):  # what no number of the nominal form explains may have led them astray
            others = [np.concatenate([self.declared, b[len(self.declared) :]]) for b in begins]
            tried = [fit(b, iterations=GLANCE) for b in [*begins, *others]]
            begins = [f.values for f in sorted(tried, key=lambda f: f.cost)[: len(begins)]]
        fits = [fit(b, iterations=RACE, tolerance=1e-2) for b in begins]
        return sorted(fits, key=lambda f: f.cost)[: KEPT if self.exact else 1]

    def settle(self, parent_cost: float, name: str, raced: Sequence[RolloutFit]) -> Candidate:
        """The best fit of what did best in a race, a value between corners zoomed in on where that
        is better than the parent."""
        hypothesis, fit = raced[0].hypothesis, self.fitter.fit
        resting = self.resting(raced[0].values, [name])
        near = [
            fit(
                self.short,
                hypothesis,
                f.values,
                f.starts,
                iterations=SETTLE,
                tolerance=1e-3,
                fixed=resting,
            )
            for f in raced
        ]
        apart = [f for i, f in enumerate(near) if not any(_same(f, g) for g in near[:i])]
        settled = [
            fit(
                self.adaptation,
                hypothesis,
                f.values,
                self._begun(self.adaptation, f),
                iterations=SETTLE,
                tolerance=1e-3,
                fixed=resting,
            )
            for f in apart
        ]
        best = min(settled, key=lambda f: f.cost)
        if resting:
            asked = [
                fit(self.adaptation, hypothesis, v, best.starts, iterations=SETTLE, tolerance=1e-3)
                for v in self._asked(best, name)
            ]
            free = min(asked, key=lambda f: f.cost)
            best = free if _asks(best, free) else best
        best = self._pruned(best, [name])
        zoomed = kind(name).zoomed
        return self.candidate(
            self._zoomed(best, name, zoomed) if zoomed and best.cost < parent_cost else best
        )

    def refine(self, candidate: Candidate) -> Candidate:
        """The same fitted until nothing moves."""
        at = candidate.fit
        if self._corners(at.hypothesis):
            windows = {digest: Start(start.windows, {}) for digest, start in at.starts.items()}
            starts = (
                self.placed(self.adaptation, at)
                if self.pieces
                else self._recalled(self.adaptation, at, windows)
            )
            begun = self.fitter.started(self.adaptation, at.hypothesis, at.values, starts, CHECK)
            at = begun if begun.cost < at.cost else at
        fit = self.fitter.fit(
            self.adaptation,
            at.hypothesis,
            at.values,
            at.starts,
            iterations=25,
            tolerance=1e-6 if self.exact else 1e-4,
            fixed=self.still(at),
        )
        for name in candidate.hypothesis.effects:
            fit = self._turned(fit, name)
            for parameter in kind(name).threshold[: int(self.exact)]:
                fit = self._zoomed(fit, name, parameter)
        return self.candidate(self.pruned(min(fit, candidate.fit, key=lambda f: f.cost)))

    def converged(self, fit: RolloutFit) -> Candidate:
        """A fit taken to its minimum, and every other that the data do not tell from it; of a
        robot, whose fits take long, its own alone.

        Numbers stay that its log does not ask for, or that a grid has found.
        """
        still, grids = (
            self.still(fit),
            [(t, kind(t).zoomed) for t in fit.hypothesis.effects if kind(t).zoomed],
        )
        if len(self.declared):
            found = [converge(self.fitter, self.adaptation, fit, [*still, *grids], ROBOT_STEPS)]
        else:
            found = minima(self.fitter, self.adaptation, fit, [*still, *grids])
        if grids:  # what a grid has found is among the estimates, too
            again = partial(
                self.fitter.fit, self.adaptation, fit.hypothesis, iterations=0, fixed=still
            )
            found = [
                replace(again(f.values, f.starts), off=f.off, converged=f.converged) for f in found
            ]
        best, *others = found
        return replace(self.candidate(best), others=tuple(others))

    def candidate(self, fit: RolloutFit, starts: Mapping[str, Start] | None = None) -> Candidate:
        """A fit as a candidate, with the starts of validation windows estimated, from given ones
        too."""
        checks = [self._checked(fit)]
        if starts is not None:
            checks.append(
                self.fitter.started(self.validation, fit.hypothesis, fit.values, starts, CHECK)
            )
        return Candidate(fit, min(checks, key=lambda f: f.cost), self._resolved(fit))

    def _resolved(self, fit: RolloutFit) -> bool:
        """Whether no effect of a fit is so small that it stands for the integration."""
        period_s = max(s.period_s for s in self.adaptation)
        return all(
            abs(fit.values[self.fitter.block.rows(t)[0]]) >= kind(t).least_periods * period_s
            for t in fit.hypothesis.effects
        )

    def _begins(self, parent: RolloutFit, of: str, expected: np.ndarray) -> list[np.ndarray]:
        """Parameter vectors from which a fit begins: those of a periodicity, or the starts of which
        a linear model expects most."""
        if of not in self.pitches:
            return [
                self.fitter.with_effect(parent.values, of, kind(of).starts[i])
                for i in _apart(expected)
            ]
        begins = []
        for family, start in self.pitches[of]:
            values = self.fitter.with_effect(parent.values, of, start)
            if not parent.hypothesis.effects:
                values[: len(family)] = family
            begins.append(values)
        return begins

    def _asked(self, best: RolloutFit, of: str) -> list[np.ndarray]:
        """Parameter vectors from which the numbers of a term that stayed at their null are
        tried."""
        rows, effect = self.fitter.block.rows_of(of), kind(of)
        begins = []
        for values in effect.tries:
            given = dict(zip(effect.optional, values, strict=True))
            start = [
                given.get(n.name, best.values[rows[n.name]] / self.fitter.unit(of, n.scale))
                for n in effect.params
            ]
            begins.append(self.fitter.with_effect(best.values, of, start))
        return begins or [best.values]

    def _pruned(self, best: RolloutFit, terms: Sequence[str]) -> RolloutFit:
        """The fit with each number at its null that it may do without, where the log does not ask
        for it; those are free no more."""
        fixed = self.resting(best.values, terms)
        alone = [(t, (name,)) for t in terms for name in kind(t).optional if not kind(t).tries]
        for of, names in [
            *alone,
            *((t, kind(t).optional) for t in terms if kind(t).tries),
        ]:  # numbers that are tried together go together
            if all((of, name) in fixed for name in names):
                continue
            values, rows = (
                best.values.copy(),
                [self.fitter.block.rows_of(of)[name] for name in names],
            )
            values[rows] = self.fitter.block.nulls[rows]
            without = [*fixed, *((of, name) for name in names if (of, name) not in fixed)]
            plain = self.fitter.fit(
                self.adaptation,
                best.hypothesis,
                values,
                best.starts,
                iterations=RACE,
                tolerance=1e-3,
                fixed=without,
            )
            if not _asks(plain, best):
                best, fixed = plain, without
        return best

    def pruned(self, fit: RolloutFit) -> RolloutFit:
        """A fit without the numbers that its log does not ask for."""
        return self._pruned(fit, fit.hypothesis.effects)

    def _zoomed(self, best: RolloutFit, effect: str, parameter: str) -> RolloutFit:
        """The best of ever finer grids around one number, along which the error has corners."""
        row, resting = self.fitter.block.rows_of(effect)[parameter], self.still(best)
        for width in ZOOMS:
            centre = best.values[row]
            for point in ZOOM_POINTS:
                values = best.values.copy()
                values[row] = centre * (1.0 + width * point)
                fixed = [*resting, (effect, parameter)]
                tried = self.fitter.fit(
                    self.adaptation, best.hypothesis, values, best.starts, iterations=2, fixed=fixed
                )
                best = tried if tried.cost < best.cost else best
        free = self.fitter.fit(
            self.adaptation, best.hypothesis, best.values, best.starts, iterations=4, fixed=resting
        )
        return free if free.cost <= best.cost else best

    def _turned(self, best: RolloutFit, of: str) -> RolloutFit:
        """The best of the fit and of those from the other end of a number between 0 and 1: laws of
        two shapes have a valley each."""
        for number in (
            n
            for n in kind(of).params
            if n.name in kind(of).optional and (n.low, n.high) == (0.0, 1.0)
        ):
            values = best.values.copy()
            row = self.fitter.block.rows_of(of)[number.name]
            values[row] = 0.0 if values[row] > 0.5 else 1.0  # noqa: PLR2004  (the end that is further)
            rest = [x for x in self.resting(best.values, [of]) if x != (of, number.name)]
            tried = self.fitter.fit(
                self.adaptation,
                best.hypothesis,
                values,
                best.starts,
                iterations=SETTLE,
                tolerance=1e-4,
                fixed=rest,
            )
            best = tried if tried.cost < best.cost else best
        return best

    def _begun(self, data: Sequence[Series], fit: RolloutFit) -> dict[str, Start]:
        """Where a fit of other windows goes on: a robot's where that places them, a joint's where
        they were seen."""
        return self.placed(data, fit) if self.pieces else _remembering(data, fit)

    def placed(self, data: Sequence[Series], fit: RolloutFit) -> dict[str, Start]:
        """Where the windows of episodes start by a fit, and what hidden states began with.

        Of a robot piece by piece: a long window that starts where a sensor wrongly says ends far
        away, and nothing leads back.
        """
        pieces = [self.pieces.get(s.digest, s) for s in data]
        starts = self._recalled(pieces, fit, _remembering(pieces, fit))
        if not self.pieces:
            return starts
        found = self.fitter.started(pieces, fit.hypothesis, fit.values, starts, CHECK).starts
        at = {s.digest: p.resets[s.resets >= 0] for s, p in zip(data, pieces, strict=True)}
        return {
            digest: Start(start.windows[at[digest]], start.memory)
            for digest, start in found.items()
        }

    def _checked(self, fit: RolloutFit) -> RolloutFit:
        """The starts of validation windows."""
        return self.fitter.started(
            self.validation, fit.hypothesis, fit.values, self.placed(self.validation, fit), CHECK
        )

    def _recalled(
        self, data: Sequence[Series], fit: RolloutFit, starts: dict[str, Start]
    ) -> dict[str, Start]:
        """The same with what hidden states with corners began with sought at many places in each
        episode."""
        for key in self._corners(fit.hypothesis):
            starts = {s.digest: self._scanned(s, fit, starts[s.digest], key) for s in data}
        return starts

    def _scanned(self, s: Series, fit: RolloutFit, start: Start, key: Memory) -> Start:
        """A start with the best of many pasts of one hidden state, one in each lane, from windows
        that know of none of them."""
        effect, memories = kind(key[0]), self.fitter.block.memories
        scale = self.fitter.unit(key[0], effect.memory[effect.states.index(key[1])])
        offsets = np.array([start.memory.get(key, 0.0), *(past * scale for past in PASTS)])
        p = self.fitter.repeated(
            fit.values, replace(start, memory={k: x for k, x in start.memory.items() if k != key})
        )
        p[memories[key], : len(offsets)] += offsets
        out = roll(
            s,
            self.fitter.form,
            p,
            switches(fit.hypothesis, self.fitter.joints),
            np.repeat(s.begin[:, :, None], BLOCK, axis=2),
        )
        counted = s.usable & (s.window_of >= 0)[:, None]
        with np.errstate(over="ignore", invalid="ignore"):
            missed = np.where(
                counted[:, :, None],
                (s.observed[:, :, None] - out) / self.fitter.sigma[:, None],
                0.0,
            )
            costs = np.nan_to_num(np.square(missed).sum(axis=(0, 1)), nan=np.inf)[: len(offsets)]
        return Start(start.windows, {**start.memory, key: float(offsets[int(np.argmin(costs))])})

    def still(self, fit: RolloutFit) -> list[tuple[str, str]]:
        """The numbers of a fit that its log does not ask for."""
        return self.resting(fit.values, fit.hypothesis.effects)

    def resting(self, values: np.ndarray, terms: Sequence[str]) -> list[tuple[str, str]]:
        """The numbers that stay at their null unless the log asks for them, and are there."""
        nulls, block = self.fitter.block.nulls, self.fitter.block
        return [
            (t, name)
            for t in terms
            for name in kind(t).optional
            if values[block.rows_of(t)[name]] == nulls[block.rows_of(t)[name]]
        ]

    def _corners(self, hypothesis: Hypothesis) -> list[Memory]:
        """The hidden states of effects with corners, so that what they began with is not found by
        descent."""
        return [
            key
            for key in self.fitter.block.memories
            if key[0] in hypothesis.effects and kind(key[0]).threshold
        ]

    def without(self, values: np.ndarray, of: str) -> np.ndarray:
        values = values.copy()
        rows = list(self.fitter.block.rows(of))
        values[rows] = self.fitter.block.nulls[rows]
        return values

    def starts(self, of: str) -> Sequence[Sequence[float]]:
        """Where a term is begun."""
        return [start for _, start in self.pitches[of]] if of in self.pitches else kind(of).starts


def trajectory(fitter: Fitter, fit: RolloutFit, s: Series) -> np.ndarray:
    """What a fit says was observed, `(samples, 2 x joints)`, from the starts that were estimated
    for it."""
    p = fitter.repeated(fit.values, fit.starts[s.digest])
    init = np.repeat(fit.starts[s.digest].windows[:, :, None], BLOCK, axis=2)
    return np.asarray(
        roll(s, fitter.form, p, switches(fit.hypothesis, fitter.joints), init)[:, :, 0]
    )


def _remembering(data: Sequence[Series], fit: RolloutFit) -> dict[str, Start]:
    """Starts that know nothing but what hidden states began with in a fit of the same episodes in
    other windows."""
    return {
        s.digest: Start(s.begin, fit.starts[s.digest].memory if s.digest in fit.starts else {})
        for s in data
    }


def _apart(expected: np.ndarray) -> list[int]:
    """The most promising starts, no two of them neighbours; where a linear model prefers none, some
    that are far apart."""
    most = RACED if len(expected) < MANY else 2 * RACED
    if np.ptp(expected) == 0.0:
        return (
            [int(i) for i in (np.arange(most) + 1) * len(expected) // (most + 1)]
            if len(expected) > most
            else list(range(len(expected)))
        )
    chosen: list[int] = []
    for i in np.argsort(expected, kind="stable"):
        if all(abs(int(i) - j) > max(1, len(expected) // FAR) for j in chosen):
            chosen.append(int(i))
    return chosen[:most]


def _begins_alike(one: RolloutFit, other: RolloutFit) -> bool:
    """Whether fits of one composition are the same where a fit of other windows begins from
    them."""
    memories = [
        {digest: dict(start.memory) for digest, start in fit.starts.items()} for fit in (one, other)
    ]
    return one is other or (np.array_equal(one.values, other.values) and memories[0] == memories[1])


def _asks(without: RolloutFit, best: RolloutFit) -> bool:
    """Whether a number is worth its while."""
    return without.cost > best.cost + ASKED_FOR * max(best.misfit, 1.0)


def _same(one: RolloutFit, other: RolloutFit) -> bool:
    """Whether two fits of one composition ended at the same place."""
    here, there = one.free.at(one.values), one.free.at(other.values)
    near = np.abs(here - there) < SAME_PLACE * (one.free.step + np.abs(here))
    return bool(near.all()) and abs(one.cost - other.cost) < SAME_COST * other.cost
