"""Search problem: what a search of compositions works on, and its three kinds of fits.

A *term* is one effect at one joint, a *composition* the terms that act together (a `Hypothesis`). A
term is *screened* by short fits from several initial guesses, *fitted* on whole windows where it
did well, and *converged* until nothing moves. What these answer depends on the problem and their
arguments alone, so another process that has the episodes can do them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from trueup.cores import in_parallel
from trueup.diagnose.candidate import Candidate
from trueup.diagnose.spatial_periods import PeriodicGuess
from trueup.diagnose.strategy import Strategy
from trueup.diagnose.tuning import SEARCH
from trueup.diagnose.windowed_fits import Numbers, WindowedFits, is_worth_it, observed_starts
from trueup.fit.errors import KeptDerivatives
from trueup.fit.fitter import Fitter
from trueup.fit.multiple_shooting import estimate_starts
from trueup.fit.rollout_fit import RolloutFit
from trueup.fit.screening import Screening, screen
from trueup.model.block import kind
from trueup.model.hypothesis import Hypothesis
from trueup.model.series import Scheme, Series


@dataclass(frozen=True, slots=True)
class ShortFit:
    """A parent's fit on short windows, the derivatives that its extensions may begin with, and what
    a linear model expects of a term, by term."""

    parent: RolloutFit
    fit: RolloutFit
    derivatives: KeptDerivatives | None
    screened: dict[str, Screening]


@dataclass(frozen=True, eq=False)
class SearchProblem:
    """What is searched.

    `fits` are the whole windows, `short` the windows on which terms are screened, `base` the
    nominal form refitted. `nominal_numbers` are the declared ones. `periodic` are initial guesses
    of terms that repeat with the position; `evident` are those among them that explain much of the
    missing force by themselves, and are screened in any case. Parents' fits on short windows are
    kept, so that each is made once.
    """

    fits: WindowedFits
    short: Sequence[Series]
    base: RolloutFit
    nominal_numbers: Sequence[float]
    periodic: Mapping[str, Sequence[PeriodicGuess]]
    evident: Sequence[str] = ()
    _short_fits: dict[Hypothesis, ShortFit] = field(default_factory=dict)

    @property
    def fitter(self) -> Fitter:
        """What fits."""
        return self.fits.fitter

    @property
    def strategy(self) -> Strategy:
        """How the plant is diagnosed."""
        return self.fits.strategy

    @property
    def adaptation(self) -> Sequence[Series]:
        """The episodes that are fitted, in whole windows."""
        return self.fits.adaptation

    @property
    def validation(self) -> Sequence[Series]:
        """The episodes that compare, in whole windows."""
        return self.fits.validation

    @property
    def scheme(self) -> Scheme:
        """How the windows are integrated."""
        return self.fits.scheme

    def short_fit(self, parent: RolloutFit) -> ShortFit:
        """A parent's fit on short windows."""
        known = self._short_fits.get(parent.hypothesis)
        if known is None or not _begin_alike(known.parent, parent):
            starts = observed_starts(self.short, parent)
            fit = estimate_starts(
                self.fitter,
                self.short,
                parent.hypothesis,
                parent.values,
                starts,
                SEARCH.short_iterations,
            )
            derivatives = self.fitter.derivatives_of(self.short, fit)
            known = ShortFit(parent, fit, derivatives, {})
            self._short_fits[parent.hypothesis] = known
        return known

    def screened(self, parent: RolloutFit, names: Sequence[str]) -> dict[str, Screening]:
        """What a linear model expects of terms beside a parent, each worked out once.

        On short windows: there it reaches further, for no error has grown yet.
        """
        near = self.short_fit(parent)
        new = [n for n in names if n not in near.screened]
        expect = partial(screen, self.fitter, self.short, near.fit)
        screenings = in_parallel(lambda n: expect(n, near.derivatives, self.guesses(n)), new)
        near.screened.update(zip(new, screenings, strict=True))
        return {n: near.screened[n] for n in names}

    def shown_freely(
        self, parent: RolloutFit, data: Sequence[Series], near: ShortFit | None = None
    ) -> Callable[[str], Screening]:
        """What a linear model expects of a term beside a parent whose windows may start elsewhere,
        even where fits hold them: a bias that every start could take up is not shown. Where the
        parent is a fit `near` another on short windows, what was screened there is known."""
        held = self.fitter.held
        fitter = self.fitter.freed() if held else self.fitter
        kept = None if held or near is None else near.derivatives
        known = {} if held or near is None else near.screened  # periodic terms by other guesses
        return lambda of: (
            known[of]
            if of in known and of not in self.periodic
            else screen(fitter, data, parent, of, kept)
        )

    def guesses(self, of: str) -> Sequence[Sequence[float]]:
        """Initial guesses of a term, in units of its numbers' scales."""
        return [guess for _, guess in self.periodic[of]] if of in self.periodic else kind(of).starts

    def screen(self, parent: RolloutFit, term: str, expected: np.ndarray) -> list[RolloutFit]:
        """Short fits of a composition with one term more, from several initial guesses: those that
        go on, the best first.

        `expected` `(guesses,)` is the cost that a linear model expects of each of the term's
        guesses.
        """
        begins, near = self._begins(parent, term, expected), self.short_fit(parent)
        fit = partial(
            self.fitter.fit,
            self.short,
            parent.hypothesis | term,
            starts=observed_starts(self.short, near.fit),
            fixed=self.fits.resting(begins[0], [term]),
            derivatives=near.derivatives,
        )
        if self.strategy.thorough and self.strategy.robot:
            # the parent's numbers may be wrong where it lacks an effect: try declared ones, too
            declared = self.nominal_numbers
            others = [np.concatenate([declared, b[len(declared) :]]) for b in begins]
            glances = [fit(b, iterations=SEARCH.glance_iterations) for b in [*begins, *others]]
            begins = [f.values for f in sorted(glances, key=lambda f: f.cost)[: len(begins)]]
        elif self.strategy.robot:  # a fit of a machine's takes long: the best glance goes on
            glances = [fit(b, iterations=SEARCH.glance_iterations) for b in begins]
            begins = [min(glances, key=lambda f: f.cost).values]
        screened = [
            fit(b, iterations=SEARCH.screen_iterations, tolerance=SEARCH.screen_tolerance)
            for b in begins
        ]
        kept = SEARCH.guesses_kept if self.strategy.thorough else 1
        return sorted(screened, key=lambda f: f.cost)[:kept]

    def fit(self, parent_cost: float, term: str, screened: Sequence[RolloutFit]) -> Candidate:
        """The best fit on whole windows of what screened best; a value between corners is refined
        by grids where the fit is better than the parent."""
        hypothesis = screened[0].hypothesis
        resting = self.fits.resting(screened[0].values, [term])
        fit = partial(
            self.fitter.fit,
            iterations=SEARCH.fit_iterations,
            tolerance=SEARCH.fit_tolerance,
        )
        near = [fit(self.short, hypothesis, f.values, f.starts, fixed=resting) for f in screened]
        distinct = [f for i, f in enumerate(near) if not any(_same_place(f, g) for g in near[:i])]
        whole = [
            fit(
                self.adaptation,
                hypothesis,
                f.values,
                self.fits.starts_after(self.adaptation, f),
                fixed=resting,
            )
            for f in distinct
        ]
        best = min(whole, key=lambda f: f.cost)
        if resting:
            freed = [
                fit(self.adaptation, hypothesis, values, best.starts)
                for values in self._with_optional_numbers(best, term)
            ]
            free = min(freed, key=lambda f: f.cost)
            best = free if is_worth_it(best, free) else best
        best = self.fits.pruned(best, [term])
        refined = kind(term).grid_refined
        if refined and best.cost < parent_cost:
            best = self._grid_refined(best, term, refined)
        return self.fits.candidate(best)

    def converge(self, candidate: Candidate) -> Candidate:
        """The composition fitted until nothing moves; no worse than it was."""
        at = self.fits.with_initial_states(candidate.fit)
        fit = self.fitter.fit(
            self.adaptation,
            at.hypothesis,
            at.values,
            at.starts,
            iterations=SEARCH.converge_iterations,
            tolerance=SEARCH.converge_tolerance
            if self.strategy.thorough
            else SEARCH.rough_tolerance,
            fixed=self._resting(at),
        )
        for term in candidate.hypothesis.effects:
            fit = self._from_other_end(fit, term)
            for parameter in kind(term).threshold[:1] if self.strategy.thorough else ():
                fit = self._grid_refined(fit, term, parameter)
        cheaper = min(fit, candidate.fit, key=lambda f: f.cost)
        return self.fits.candidate(self.fits.pruned(cheaper))

    def _resting(self, fit: RolloutFit) -> Numbers:
        return self.fits.resting(fit.values, fit.hypothesis.effects)

    def _begins(self, parent: RolloutFit, of: str, expected: np.ndarray) -> list[np.ndarray]:
        """The block's vectors from which a term is screened: those of spatial periods, or the
        guesses of which a linear model expects most."""
        if of not in self.periodic:
            guesses = kind(of).starts
            return [
                self.fitter.with_effect(parent.values, of, guesses[i])
                for i in most_promising(expected)
            ]
        begins = []
        for family, guess in self.periodic[of]:
            values = self.fitter.with_effect(parent.values, of, guess)
            if not parent.hypothesis.effects:
                values[: len(family)] = family
            begins.append(values)
        return begins

    def _with_optional_numbers(self, best: RolloutFit, of: str) -> list[np.ndarray]:
        """The block's vectors from which a term's numbers that stayed at their null are tried."""
        rows, effect = self.fitter.block.rows_of(of), kind(of)
        begins = []
        for values in effect.tries:
            tried = dict(zip(effect.optional, values, strict=True))
            guess = [
                tried.get(n.name, best.values[rows[n.name]] / self.fitter.unit(of, n.scale))
                for n in effect.params
            ]
            begins.append(self.fitter.with_effect(best.values, of, guess))
        return begins or [best.values]

    def _grid_refined(self, best: RolloutFit, term: str, parameter: str) -> RolloutFit:
        """The best of ever finer grids around one number, along which the error has corners."""
        row, resting = self.fitter.block.rows_of(term)[parameter], self._resting(best)
        fit = partial(self.fitter.fit, self.adaptation, best.hypothesis)
        for width in SEARCH.grids:
            centre = best.values[row]
            for point in SEARCH.grid_points:
                values = best.values.copy()
                values[row] = centre * (1.0 + width * point)
                fixed = [*resting, (term, parameter)]
                tried = fit(values, best.starts, iterations=SEARCH.grid_iterations, fixed=fixed)
                best = tried if tried.cost < best.cost else best
        free = fit(best.values, best.starts, iterations=SEARCH.after_grid_iterations, fixed=resting)
        return free if free.cost <= best.cost else best

    def _from_other_end(self, best: RolloutFit, of: str) -> RolloutFit:
        """The best of the fit and of fits from the other end of each number between 0 and 1: such a
        number chooses between two shapes of a law, and each shape has a minimum of its own."""
        for number in kind(of).params:
            if number.name not in kind(of).optional or (number.low, number.high) != (0.0, 1.0):
                continue
            values = best.values.copy()
            row = self.fitter.block.rows_of(of)[number.name]
            values[row] = 0.0 if values[row] > 0.5 else 1.0  # noqa: PLR2004  (the end that is further)
            resting = self.fits.resting(best.values, [of])
            tried = self.fitter.fit(
                self.adaptation,
                best.hypothesis,
                values,
                best.starts,
                iterations=SEARCH.fit_iterations,
                fixed=[x for x in resting if x != (of, number.name)],
            )
            best = tried if tried.cost < best.cost else best
        return best


def most_promising(expected: np.ndarray) -> list[int]:
    """The most promising initial guesses by their expected costs `(guesses,)`, no two of them
    neighbours; where a linear model prefers none, some that are far apart."""
    count = len(expected)
    most = SEARCH.guesses if count < SEARCH.many_guesses else 2 * SEARCH.guesses
    if np.ptp(expected) == 0.0:
        if count <= most:
            return list(range(count))
        return [int(i) for i in (np.arange(most) + 1) * count // (most + 1)]
    chosen: list[int] = []
    for i in np.argsort(expected, kind="stable"):
        if all(abs(int(i) - j) > max(1, count // SEARCH.neighbours) for j in chosen):
            chosen.append(int(i))
    return chosen[:most]


def _begin_alike(one: RolloutFit, other: RolloutFit) -> bool:
    """Whether two fits of one composition give the same beginning to a fit of other windows."""
    memories = [
        {digest: dict(start.memory) for digest, start in fit.starts.items()} for fit in (one, other)
    ]
    return one is other or (np.array_equal(one.values, other.values) and memories[0] == memories[1])


def _same_place(one: RolloutFit, other: RolloutFit) -> bool:
    """Whether two fits of one composition ended at one place."""
    here, there = one.free.at(one.values), one.free.at(other.values)
    near = np.abs(here - there) < SEARCH.same_place * (one.free.step + np.abs(here))
    return bool(near.all()) and abs(one.cost - other.cost) < SEARCH.same_cost * other.cost
