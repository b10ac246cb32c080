"""Search: which compositions of effects explain the episodes, by rollout fits that grow one term at
a time: one effect at one joint.

Every term is tried on the nominal form, every other on the best of those, and so on.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TypeVar

import numpy as np

from trueup.cores import in_parallel
from trueup.diagnose.candidate import Candidate
from trueup.diagnose.indistinguishable import aliases
from trueup.diagnose.search_problem import SearchProblem
from trueup.diagnose.tasks import Converge, Fit, Screen, Solve, in_threads
from trueup.diagnose.tuning import SEARCH
from trueup.fit.rollout_fit import RolloutFit, Start
from trueup.model.block import joint as joint_of
from trueup.model.block import kind
from trueup.model.effect import Port, effects
from trueup.model.hypothesis import Hypothesis

Result = TypeVar("Result")
SCREENING_SHARE = 0.5  # of the time of an extension
Screened = tuple[Candidate, str, list[RolloutFit]]  # a parent, a term, its short fits


@dataclass
class Search:
    """Compositions found for one problem, by hypothesis; grows as it is asked. Others than our own
    threads may `solve` its tasks."""

    problem: SearchProblem
    terms: Sequence[str] = ()  # what is sought
    solve: Solve = in_threads
    candidates: dict[Hypothesis, Candidate] = field(default_factory=dict)

    @property
    def base(self) -> Candidate:
        """The nominal form refitted, without any effect."""
        return self.candidates[Hypothesis()]

    def extend(
        self,
        parents: Sequence[Candidate],
        terms: Sequence[str],
        progress: Callable[[float], None] = lambda _: None,
        most: int = 0,
        fitted: int = 0,
        others: Sequence[Candidate] = (),
    ) -> list[Candidate]:
        """Each parent with each term that it has not, where not fitted before; the best first.

        With `most`, only so many terms of each parent, those of which a linear model expects most;
        with `fitted`, only so many of all are fitted on whole windows, those that screened best.
        `others` are parents that get few terms of their own, and those that screened best with the
        first ones: where two effects act, many may stand for the one, and the other is the same.
        """
        promising = [(p, *term) for p in parents for term in self._promising(p, terms, most)]
        screened = self._screened(promising, progress)
        if others:
            names = list(dict.fromkeys(name for _, name, _ in screened))[: SEARCH.partners]
            few = [
                (p, *term)
                for p in others
                for term in [
                    *self._promising(p, names, 0),
                    *self._promising(p, terms, SEARCH.partners),
                ]
            ]
            already = {parent.hypothesis | name for parent, name, _ in screened}
            screened += self._screened(
                [x for x in few if x[0].hypothesis | x[1] not in already], lambda _: None
            )
            screened.sort(key=_least_cost)
        if fitted and screened and screened[0][2][0].reduced_chi_square < SEARCH.explained:
            screened = [x for x in screened if x[2][0].reduced_chi_square < SEARCH.poor]
        tasks = [Fit(parent.fit.cost, name, fits) for parent, name, fits in screened]
        candidates = self.solve(
            self.problem,
            tasks[: fitted or None],
            lambda share: progress(SCREENING_SHARE + (1.0 - SCREENING_SHARE) * share),
        )
        resolved = [c for c in map(self.adopt, candidates) if c.resolved]
        return sorted(resolved, key=lambda c: c.reduced_chi_square)

    def _screened(
        self, wanted: Sequence[tuple[Candidate, str, np.ndarray]], progress: Callable[[float], None]
    ) -> list[Screened]:
        """Short fits of terms with parents, each composition once, the best first."""
        jobs: dict[Hypothesis, tuple[Candidate, str, np.ndarray]] = {}
        for parent, name, expected in wanted:
            jobs.setdefault(parent.hypothesis | name, (parent, name, expected))
        tasks = [Screen(parent.fit, name, expected) for parent, name, expected in jobs.values()]
        fits = self.solve(self.problem, tasks, lambda share: progress(SCREENING_SHARE * share))
        screened = [
            (parent, name, of) for (parent, name, _), of in zip(jobs.values(), fits, strict=True)
        ]
        return sorted(screened, key=_least_cost)

    def _promising(
        self, parent: Candidate, names: Sequence[str], most: int
    ) -> list[tuple[str, np.ndarray]]:
        """The terms to try, with the cost that a linear model expects of each of their initial
        guesses, the most promising first."""
        problem = self.problem
        wanted = [
            (n, parent.hypothesis | n) for n in names if not has_already(parent.hypothesis, n)
        ]
        rest = [n for n, h in wanted if h not in self.candidates and problem.fitter.has_room(h)]
        screened = problem.screened(parent.fit, rest)
        order = [rest[i] for i in np.argsort([screened[n].cost.min() for n in rest], kind="stable")]
        if most:
            evident = [n for n in order if n in problem.evident]
            order = evident + _spread([n for n in order if n not in evident], most)
        return [(n, screened[n].cost) for n in order]

    def suspected(self, parent: Candidate, here: int, others: int) -> list[str]:
        """So many terms at the joint where a linear model expects most of one, and so many of the
        other joints', the most promising; 0 is all."""
        order = [name for name, _ in self._promising(parent, self.terms, 0)]
        joint = joint_of(order[0])
        chosen = [t for t in order if joint_of(t) == joint][: here or None]
        chosen += [t for t in order if joint_of(t) != joint][:others]
        return chosen + [t for t in self.problem.evident if t not in chosen]

    def everywhere(self, candidate: Candidate) -> Candidate | None:
        """The candidate with each of its effects at every joint where it is sought, begun there at
        the same size; None where that is no other composition, or an effect has to be sought at
        many places.
        """
        fitter, fits = self.problem.fitter, self.problem.fits
        hypothesis, values = candidate.hypothesis, candidate.fit.values.copy()
        for at in candidate.hypothesis.effects:
            effect = kind(at)
            if effect.grid_refined or effect.periodic or effect.port is Port.TIMING:
                return None
            rows = list(fitter.block.rows(at))
            for t in self.terms:
                if kind(t) is not effect or has_already(hypothesis, t):
                    continue
                hypothesis = hypothesis | t
                units = [fitter.unit(t, n.scale) / fitter.unit(at, n.scale) for n in effect.params]
                values[list(fitter.block.rows(t))] = values[rows] * units
        if hypothesis in self.candidates or hypothesis == candidate.hypothesis:
            return None
        fit = partial(
            fitter.fit,
            iterations=SEARCH.fit_iterations,
            fixed=fits.resting(values, hypothesis.effects),
        )
        near = fit(self.problem.short, hypothesis, values, tolerance=SEARCH.screen_tolerance)
        starts = fits.estimated_starts(self.problem.adaptation, near)
        return self.keep(
            fit(
                self.problem.adaptation,
                hypothesis,
                near.values,
                starts,
                tolerance=SEARCH.fit_tolerance,
            )
        )

    def fitted(self, hypothesis: Hypothesis, larger: Candidate) -> Candidate:
        """A part of a composition, fitted if it was not yet."""
        if hypothesis not in self.candidates:
            values = larger.fit.values
            for name in set(larger.hypothesis.effects) - set(hypothesis.effects):
                values = self.problem.fits.without(values, name)
            self.keep(
                self.problem.fitter.fit(
                    self.problem.adaptation,
                    hypothesis,
                    values,
                    larger.fit.starts,
                    iterations=SEARCH.fit_iterations,
                )
            )
        return self.candidates[hypothesis]

    def at_once(
        self, work: Callable[[Search, Candidate], Result], candidates: Sequence[Candidate]
    ) -> list[Result]:
        """Work on each candidate, in threads; the answers, and what is known afterwards, do not
        depend on which thread is faster.

        Each works on a copy of what is known now. Of what they found the cheaper fit is kept, and
        of equal ones that of the candidate that comes first.
        """
        copies = [replace(self, candidates=dict(self.candidates)) for _ in candidates]
        answers = list(
            in_parallel(lambda pair: work(*pair), list(zip(copies, candidates, strict=True)))
        )
        for copy in copies:
            for candidate in copy.candidates.values():
                known = self.candidates.get(candidate.hypothesis)
                if known is None or candidate.fit.cost < known.fit.cost:
                    self.adopt(candidate)
        return answers

    def eliminate_all(self, candidate: Candidate) -> list[Candidate]:
        """Backward elimination along every path: each composition with one effect less, fitted from
        where this one is, and so on from those that do about as well; kept where that is better
        than what was found."""
        better = self._smaller(candidate)
        for part in list(better):
            if len(part.hypothesis.effects) > 1 and _does_as_well(part, candidate):
                better += self.eliminate_all(part)
        return better

    def eliminate(self, candidate: Candidate) -> None:
        """Backward elimination along one path: the effect that is missed least is left out, again
        and again, while the rest does about as well."""
        while len(candidate.hypothesis.effects) > 1:
            self._smaller(candidate)
            parts = [
                self.candidates[candidate.hypothesis.without(name)]
                for name in candidate.hypothesis.effects
            ]
            least = min(parts, key=lambda c: c.fit.cost)
            if not _does_as_well(least, candidate):
                break
            candidate = least

    def _smaller(self, candidate: Candidate) -> list[Candidate]:
        """Candidates with one effect less, where they are better than what was found."""
        better = []
        for name in candidate.hypothesis.effects:
            smaller = candidate.hypothesis.without(name)
            fit = self._fit_from(
                candidate, smaller, self.problem.fits.without(candidate.fit.values, name)
            )
            if smaller not in self.candidates or fit.cost < self.candidates[smaller].fit.cost:
                better.append(self.keep(fit))
        return better

    def try_aliases(self, candidate: Candidate) -> None:
        """The candidate with each effect replaced by its alias (an effect that may look the same on
        a log), from the same place, fitted until nothing moves; kept where that is better."""
        fitter, fits = self.problem.fitter, self.problem.fits
        for effect, alias in aliases(candidate.hypothesis):
            if alias not in self.terms:
                continue
            rest = fits.without(candidate.fit.values, effect)
            replaced = candidate.hypothesis.without(effect) | alias
            ours, its = (kind(name).params[0].scale for name in (effect, alias))
            size = candidate.fit.values[fitter.block.rows(effect)[0]] / fitter.unit(effect, ours)
            guesses: list[tuple[float, ...]] = [(size,)] if ours is its else []
            if not guesses or not self.problem.strategy.robot:
                # a fit of a robot takes long, and aliases are as large as each other
                guesses += kind(alias).starts
            tried = [
                self._fit_from(candidate, replaced, fitter.with_effect(rest, alias, guess))
                for guess in guesses
            ]
            fit = min(tried, key=lambda f: f.cost)
            known = self.candidates.get(fit.hypothesis)
            if known is None or fit.cost < known.fit.cost:
                converged = self.problem.converge(self.keep(fit))
                self.keep(converged.fit, candidate.check.starts)

    def _fit_from(
        self, candidate: Candidate, hypothesis: Hypothesis, values: np.ndarray
    ) -> RolloutFit:
        """A composition fitted on whole windows from where another one's windows start."""
        return self.problem.fitter.fit(
            self.problem.adaptation,
            hypothesis,
            values,
            candidate.fit.starts,
            iterations=SEARCH.fit_iterations,
            tolerance=SEARCH.fit_tolerance,
        )

    def converge(self, candidates: Sequence[Candidate]) -> list[Candidate]:
        """Candidates fitted until nothing moves."""
        tasks = [Converge(c) for c in candidates]
        return [self.adopt(c) for c in self.solve(self.problem, tasks, lambda _: None)]

    def keep(self, fit: RolloutFit, starts: Mapping[str, Start] | None = None) -> Candidate:
        """A fit as a candidate, with the starts of validation windows estimated, from given ones
        too."""
        return self.adopt(self.problem.fits.candidate(fit, starts))

    def adopt(self, candidate: Candidate) -> Candidate:
        """Remember a candidate as what its composition can do."""
        self.candidates[candidate.hypothesis] = candidate
        return candidate

    def __iter__(self) -> Iterator[Candidate]:
        resolved = (c for c in self.candidates.values() if c.resolved)
        return iter(sorted(resolved, key=lambda c: c.reduced_chi_square))


def has_already(hypothesis: Hypothesis, of: str) -> bool:
    """Whether a term, or one at its joint whose effect contains it or that it contains, acts."""
    here = {kind(t).name for t in hypothesis.effects if joint_of(t) == joint_of(of)}
    return (
        kind(of).name in here
        or kind(of).contains in here
        or any(effects()[other].contains == kind(of).name for other in here)
    )


def _least_cost(screened: Screened) -> float:
    return screened[2][0].cost


def _does_as_well(part: Candidate, whole: Candidate) -> bool:
    """Whether a part of a composition does about as well as the whole."""
    limit = SEARCH.part_does_as_well * max(whole.reduced_chi_square, 1.0)
    return part.reduced_chi_square < limit


def _spread(order: Sequence[str], most: int) -> list[str]:
    """The first of some terms, so many, of which two thirds at most are at one joint if there are
    others: what a fit left there hides what another joint does."""
    share = -(-2 * most // 3)
    rank = {
        t: sum(joint_of(other) == joint_of(t) for other in order[:i]) for i, t in enumerate(order)
    }
    chosen = {*[t for t in order if rank[t] < share][:most]}
    chosen |= {*[t for t in order if t not in chosen][: most - len(chosen)]}
    return [t for t in order if t in chosen]
