"""Windowed fits: one plant's episodes, cut into windows under one scheme of integration, and fits
of single compositions to whole windows.

What a method answers depends on the windows and its arguments alone. Fits see adaptation episodes
alone; compositions are compared on validation episodes, where nothing but the windows' starts is
estimated.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from trueup.diagnose.candidate import Candidate
from trueup.diagnose.strategy import Strategy
from trueup.diagnose.tuning import SEARCH
from trueup.fit.convergence import converge, minima
from trueup.fit.fitter import Fitter
from trueup.fit.multiple_shooting import estimate_starts
from trueup.fit.rollout_fit import RolloutFit, Start
from trueup.model.block import BLOCK, Memory, kind
from trueup.model.hypothesis import Hypothesis, switches
from trueup.model.roll import roll
from trueup.model.series import Scheme, Series

Numbers = list[tuple[str, str]]  # (term, number) pairs


@dataclass(frozen=True, eq=False)
class WindowedFits:
    """What is fitted to which windows.

    `adaptation` and `validation` are one series for each episode, cut into windows of `length_s`
    [s]. `pieces`, by episode digest, are the same windows in pieces, in which a robot's starts are
    found; empty where starts are found on whole windows.
    """

    fitter: Fitter
    strategy: Strategy
    adaptation: Sequence[Series]
    validation: Sequence[Series]
    length_s: float
    pieces: Mapping[str, Series] = field(default_factory=dict)

    @property
    def scheme(self) -> Scheme:
        """How the windows are integrated."""
        return self.adaptation[0].scheme

    def fit_nominal_form(self, guesses: Sequence[Sequence[float]]) -> Candidate:
        """The nominal form with the numbers that fit best, from the most promising of several
        initial guesses."""
        fit = partial(self.fitter.fit, self.adaptation, Hypothesis())
        tried = [self.fitter.initial_values(g) for g in guesses]
        if len(tried) > 1:
            glances = (fit(values, iterations=SEARCH.glance_iterations) for values in tried)
            tried = [min(glances, key=lambda f: f.cost).values]
        return self.candidate(fit(tried[0], iterations=SEARCH.converge_iterations))

    def nominal(self, parameters: Sequence[float]) -> RolloutFit:
        """The nominal form with given parameters on validation episodes."""
        values = self.fitter.initial_values(parameters)
        return self._estimate(self.validation, Hypothesis(), values, None)

    def converged(self, fit: RolloutFit) -> Candidate:
        """A fit taken to its minimum, and every other minimum that the data do not tell from it; of
        a robot, whose fits take long, its own alone.

        Numbers stay that its log does not ask for, or that a grid has found.
        """
        resting = self.resting(fit.values, fit.hypothesis.effects)
        grids = _on_grids(fit)
        fixed = [*resting, *grids]
        if self.strategy.robot:
            looks = SEARCH.robot_looks
            at_minima = [converge(self.fitter, self.adaptation, fit, fixed, looks)]
        else:
            at_minima = minima(self.fitter, self.adaptation, fit, fixed)
        if grids:  # what a grid has found is among the estimates, too
            again = partial(
                self.fitter.fit, self.adaptation, fit.hypothesis, iterations=0, fixed=resting
            )
            at_minima = [
                replace(again(f.values, f.starts), distance=f.distance, converged=f.converged)
                for f in at_minima
            ]
        best, *others = at_minima
        return replace(self.candidate(best), others=tuple(others))

    def candidate(self, fit: RolloutFit, starts: Mapping[str, Start] | None = None) -> Candidate:
        """A fit as a candidate. The starts of validation windows are estimated, and a second time
        from `starts` where those are given; the cheaper estimate counts."""
        placed = self.estimated_starts(self.validation, fit)
        checks = [self._estimate(self.validation, fit.hypothesis, fit.values, placed)]
        if starts is not None:
            checks.append(self._estimate(self.validation, fit.hypothesis, fit.values, starts))
        return Candidate(fit, min(checks, key=lambda f: f.cost), self._resolved(fit))

    def _resolved(self, fit: RolloutFit) -> bool:
        """Whether no effect of a fit is so small that it may be an error of integration."""
        period_s = max(s.period_s for s in self.adaptation)
        return all(
            abs(fit.values[self.fitter.block.rows(t)[0]]) >= kind(t).least_periods * period_s
            for t in fit.hypothesis.effects
        )

    def pruned(self, best: RolloutFit, terms: Sequence[str] | None = None) -> RolloutFit:
        """The fit with optional numbers fixed at their null where the log does not ask for them;
        of some terms, or of all."""
        terms = best.hypothesis.effects if terms is None else terms
        fixed = self.resting(best.values, terms)
        alone = [(t, (name,)) for t in terms for name in kind(t).optional if not kind(t).tries]
        together = [(t, kind(t).optional) for t in terms if kind(t).tries]
        for of, names in [*alone, *together]:  # numbers that are tried together go together
            if all((of, name) in fixed for name in names):
                continue
            rows = [self.fitter.block.rows_of(of)[name] for name in names]
            values = best.values.copy()
            values[rows] = self.fitter.block.nulls[rows]
            without = [*fixed, *((of, name) for name in names if (of, name) not in fixed)]
            plain = self.fitter.fit(
                self.adaptation,
                best.hypothesis,
                values,
                best.starts,
                iterations=SEARCH.screen_iterations,
                tolerance=SEARCH.fit_tolerance,
                fixed=without,
            )
            if not is_worth_it(plain, best):
                best, fixed = plain, without
        return best

    def resting(self, values: np.ndarray, terms: Sequence[str]) -> Numbers:
        """The optional numbers of some terms that stand at their null."""
        nulls, block = self.fitter.block.nulls, self.fitter.block
        return [
            (t, name)
            for t in terms
            for name in kind(t).optional
            if values[block.rows_of(t)[name]] == nulls[block.rows_of(t)[name]]
        ]

    def without(self, values: np.ndarray, of: str) -> np.ndarray:
        """The block's vector with one term at its null."""
        values = values.copy()
        rows = list(self.fitter.block.rows(of))
        values[rows] = self.fitter.block.nulls[rows]
        return values

    def starts_after(self, data: Sequence[Series], fit: RolloutFit) -> dict[str, Start]:
        """Where windows start when a fit of other windows goes on in them: a robot's where that fit
        puts them, a joint's where they were observed."""
        return self.estimated_starts(data, fit) if self.pieces else observed_starts(data, fit)

    def taken_on(
        self, data: Sequence[Series], fit: RolloutFit, iterations: int, fixed: Numbers
    ) -> RolloutFit:
        """A fit of other windows taken on in these, from its numbers and from where windows start
        when it goes on."""
        return self.fitter.fit(
            data,
            fit.hypothesis,
            fit.values,
            self.starts_after(data, fit),
            iterations=iterations,
            fixed=fixed,
        )

    def alone(self, data: Sequence[Series], fit: RolloutFit) -> RolloutFit:
        """A composition fitted to some windows alone, from where `fit` ended, to its minimum; of a
        robot, whose fits take long, until nothing moves. What rests, or a grid has found, stays."""
        fixed = [*self.resting(fit.values, fit.hypothesis.effects), *_on_grids(fit)]
        first = self.taken_on(data, fit, SEARCH.converge_iterations, fixed)
        return first if self.strategy.robot else converge(self.fitter, data, first, fixed)

    def estimated_starts(self, data: Sequence[Series], fit: RolloutFit) -> dict[str, Start]:
        """Where the windows of episodes start by a fit, with their initial hidden states.

        A robot's starts are estimated piece by piece: a long window that starts where a sensor
        wrongly says ends far away, and descent does not lead back.
        """
        pieces = [self.pieces.get(s.digest, s) for s in data]
        starts = self._recalled(pieces, fit, observed_starts(pieces, fit))
        if not self.pieces:
            return starts
        placed = self._estimate(pieces, fit.hypothesis, fit.values, starts).starts
        first = {s.digest: p.resets[s.resets >= 0] for s, p in zip(data, pieces, strict=True)}
        return {
            digest: Start(start.windows[first[digest]], start.memory)
            for digest, start in placed.items()
        }

    def with_initial_states(self, fit: RolloutFit) -> RolloutFit:
        """The fit with other initial hidden states, sought at many places, where that costs less;
        only of effects with corners, whose initial states descent does not find."""
        if not self._with_corners(fit.hypothesis):
            return fit
        if self.pieces:
            starts = self.estimated_starts(self.adaptation, fit)
        else:
            windows = {digest: Start(start.windows, {}) for digest, start in fit.starts.items()}
            starts = self._recalled(self.adaptation, fit, windows)
        again = self._estimate(self.adaptation, fit.hypothesis, fit.values, starts)
        return again if again.cost < fit.cost else fit

    def _estimate(
        self,
        data: Sequence[Series],
        hypothesis: Hypothesis,
        values: np.ndarray,
        starts: Mapping[str, Start] | None,
    ) -> RolloutFit:
        return estimate_starts(
            self.fitter, data, hypothesis, values, starts, SEARCH.start_iterations
        )

    def _with_corners(self, hypothesis: Hypothesis) -> list[Memory]:
        """The hidden states of effects with corners: descent does not find how they began."""
        return [
            key
            for key in self.fitter.block.memories
            if key[0] in hypothesis.effects and kind(key[0]).threshold
        ]

    def _recalled(
        self, data: Sequence[Series], fit: RolloutFit, starts: dict[str, Start]
    ) -> dict[str, Start]:
        """Starts with initial hidden states sought at many places in each episode, of effects with
        corners."""
        for key in self._with_corners(fit.hypothesis):
            starts = {s.digest: self._scanned(s, fit, starts[s.digest], key) for s in data}
        return starts

    def _scanned(self, s: Series, fit: RolloutFit, start: Start, key: Memory) -> Start:
        """The start with the initial hidden state, of many tried at once, where the episode costs
        least."""
        memories, effect = self.fitter.block.memories, kind(key[0])
        scale = self.fitter.unit(key[0], effect.memory[effect.states.index(key[1])])
        pasts = (past * scale for past in SEARCH.pasts)
        offsets = np.array([start.memory.get(key, 0.0), *pasts])
        others = {k: x for k, x in start.memory.items() if k != key}
        p = self.fitter.repeated(fit.values, replace(start, memory=others))
        p[memories[key], : len(offsets)] += offsets
        on = switches(fit.hypothesis, self.fitter.joints)
        out = roll(s, self.fitter.form, p, on, np.repeat(s.begin[:, :, None], BLOCK, axis=2))
        counted = s.usable & (s.window_of >= 0)[:, None]
        with np.errstate(over="ignore", invalid="ignore"):
            errors = (s.observed[:, :, None] - out) / self.fitter.sigma[:, None]
            squares = np.square(np.where(counted[:, :, None], errors, 0.0)).sum(axis=(0, 1))
        costs = np.nan_to_num(squares, nan=np.inf)[: len(offsets)]
        return Start(start.windows, {**start.memory, key: float(offsets[int(np.argmin(costs))])})


def _on_grids(fit: RolloutFit) -> Numbers:
    """The numbers of a fit that a grid finds, since the error is flat between its corners."""
    return [(t, kind(t).grid_refined) for t in fit.hypothesis.effects if kind(t).grid_refined]


def trajectory(fitter: Fitter, fit: RolloutFit, s: Series) -> np.ndarray:
    """What a fit says was observed, `(samples, 2 x joints)`, from the starts that were estimated
    for it."""
    p = fitter.repeated(fit.values, fit.starts[s.digest])
    init = np.repeat(fit.starts[s.digest].windows[:, :, None], BLOCK, axis=2)
    return np.asarray(
        roll(s, fitter.form, p, switches(fit.hypothesis, fitter.joints), init)[:, :, 0]
    )


def observed_starts(data: Sequence[Series], fit: RolloutFit) -> dict[str, Start]:
    """Starts as observed, with the initial hidden states of a fit of the same episodes in other
    windows."""
    return {
        s.digest: Start(s.begin, fit.starts[s.digest].memory if s.digest in fit.starts else {})
        for s in data
    }


def is_worth_it(without: RolloutFit, best: RolloutFit) -> bool:
    """Whether an optional number brings more than it costs to state it."""
    worth = SEARCH.optional_worth * max(best.reduced_chi_square, 1.0)
    return without.cost > best.cost + worth
