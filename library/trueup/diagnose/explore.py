"""Explore: the search for compositions of effects, until there is nothing left to explain.

Under each scheme of integration compositions of one effect are tried, then of two, and so on, until
noise is all that is left. Where the residuals show that the noise differs from what was estimated
first, the search is repeated with the new estimate; and where something else acted in a few
stretches of a machine's recordings, without those.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from trueup.diagnose.candidate import Candidate
from trueup.diagnose.data_quality import DataQuality
from trueup.diagnose.model_selection import nothing_left
from trueup.diagnose.problem_setup import Recordings, Refitted, Setup
from trueup.diagnose.residual_noise import quality_by_residuals
from trueup.diagnose.search import Search
from trueup.diagnose.search_problem import SearchProblem
from trueup.diagnose.strategy import PAIR
from trueup.diagnose.tasks import Solve, in_threads
from trueup.diagnose.trimming import unexplained_stretches
from trueup.diagnose.tuning import DATA_QUALITY, SEARCH, SELECTION, SETUP
from trueup.fit.rollout_fit import RolloutFit
from trueup.model.block import kind
from trueup.model.hypothesis import Hypothesis
from trueup.model.series import DECLARED, Scheme, refined

Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class Searched:
    """Recordings without what was put aside, and the quality of their data, with the noise that a
    search's residuals show."""

    recordings: Recordings
    quality: DataQuality


@dataclass(frozen=True)
class Explored:
    """What was `searched`; the search under the scheme of integration that explains it best; and
    what the refitted nominal form, or the best composition, leaves where commands of undeclared
    hold are ramps, over what it leaves where they keep their values: None where that was not
    compared."""

    searched: Searched
    search: Search
    ramps_leave: float | None


def explore(
    recordings: Recordings, quality: DataQuality, progress: Progress, solve: Solve = in_threads
) -> Explored:
    """Search the compositions of effects that explain the episodes."""
    searched = Searched(recordings, quality)
    for _ in range(SEARCH.looks):
        exploration = _Exploration(searched, progress, solve)
        search, better_known = exploration.search()
        if better_known is None:
            break
        searched = better_known
    return Explored(searched, search, exploration.ramps_leave)


def unexplored(
    recordings: Recordings, quality: DataQuality, progress: Progress = lambda _stage, _part: None
) -> Search:
    """The search with which an exploration begins: the nominal form refitted, and nothing else."""
    return _Exploration(Searched(recordings, quality), progress, in_threads).first()


class _Exploration:
    """One search of recordings, by what is known of the quality of their data."""

    def __init__(self, searched: Searched, progress: Progress, solve: Solve) -> None:
        self.recordings, self.quality = searched.recordings, searched.quality
        self.criteria, self.strategy = self.recordings.criteria, self.recordings.strategy
        self.effort, self.progress, self.solve = self.strategy.effort, progress, solve
        self.ramps_leave: float | None = None
        self._refitted: dict[tuple[Scheme, int], Refitted] = {}

    def search(self) -> tuple[Search, Searched | None]:
        """The best search; and where residuals show another noise, or stretches that nothing
        explains, what is to be searched instead."""
        best: Search | None = None
        parts = 1
        for scheme in self._schemes():
            search = self._begin(scheme, parts)
            if best is not None and self.strategy.robot and not _is_promising(search, best):
                break
            generation = self._singles(search)
            better_known = self._better_known(search) if best is None else None
            if better_known is not None:
                return search, better_known
            if best is None and went_astray(search):
                parts = SETUP.pieces
                search = self._begin(scheme, parts)
                generation = self._singles(search)
            self._grow(search, generation)
            if best is None or _least_total(search) < _least_total(best):
                best = search
            if any(self._is_enough(c, search) for c in search):
                break
        assert best is not None
        otherwise = self._held_otherwise(best)
        if otherwise is not None:
            self._grow(otherwise, self._singles(otherwise))
            if _least_total(otherwise) < _least_total(best):
                best = otherwise
        return best, self._with_quality_by(best)

    def _held_otherwise(self, best: Search) -> Search | None:
        """A search with commands of undeclared hold as ramps where they were steps, or the other
        way round, if the best composition, or the best effect alone, explains the episodes plainly
        better so; None else.

        An effect may have hidden the hold from the nominal form.
        """
        at, scheme = min(best, key=lambda c: c.total), best.problem.scheme
        alone = min((c for c in best if len(c.hypothesis.effects) <= 1), key=lambda c: c.total)
        other = replace(scheme, ramped=not scheme.ramped)
        if not self._may_ramp(other) or at.total < SELECTION.adequate:
            return None
        problem = self._refit(other, 1).problem
        tried = {c.hypothesis: c for c in (alone, at)}.values()
        again = min(
            (problem.fits.candidate(_again(problem, c.fit)) for c in tried), key=lambda c: c.total
        )
        if not is_plainly_better(again, at):
            return None
        leaves = again.total / max(at.total, 1e-300)
        self.ramps_leave = leaves if other.ramped else 1.0 / max(leaves, 1e-300)
        return self._begin(other, 1)

    def first(self) -> Search:
        """The search under the likeliest scheme, before anything is sought."""
        return self._begin(self._schemes()[0], 1)

    def _schemes(self) -> list[Scheme]:
        """The schemes of integration, the likelier first; commands whose hold nobody declared as
        the refitted nominal form explains the episodes best."""
        schemes = list(dict.fromkeys([refined(self.recordings.plant), DECLARED]))
        if self.strategy.physical:
            schemes = schemes[:1]  # a machine has no step
        elif is_quiet(self.quality):
            schemes.reverse()  # a log without noise is a simulator's, made at the declared step
        ramped = self._is_ramped(schemes[0])
        return [replace(scheme, ramped=ramped) for scheme in schemes]

    def _is_ramped(self, scheme: Scheme) -> bool:
        """Whether commands of undeclared hold are ramps: the nominal form must fit plainly better,
        on most windows. Samples that are thinned lie too close for it to matter."""
        if not self._may_ramp(scheme):
            return False
        keeps = self._refit(scheme, 1).base
        rises = self._refit(replace(scheme, ramped=True), 1, near=keeps).base
        self.ramps_leave = rises.total / max(keeps.total, 1e-300)
        return is_plainly_better(rises, keeps)

    def _may_ramp(self, scheme: Scheme) -> bool:
        """Whether a command's hold is undeclared, and samples lie so far apart that it matters."""
        steps = Setup(self.recordings, self.quality, replace(scheme, ramped=False))
        return bool(self.recordings.plant.undeclared_holds) and steps.thinned_by == 1

    def _begin(self, scheme: Scheme, parts: int) -> Search:
        """A new search, which has the nominal form refitted and nothing else yet."""
        refitted = self._refit(scheme, parts)
        self.progress("the nominal form refitted", 1.0)
        known = {Hypothesis(): refitted.base}
        return Search(refitted.problem, self.recordings.terms, self.solve, known)

    def _refit(self, scheme: Scheme, parts: int, near: Candidate | None = None) -> Refitted:
        """The nominal form refitted under a scheme, from `near`, its fit under another one, where
        that is given: once."""
        if (scheme, parts) not in self._refitted:
            setup = Setup(self.recordings, self.quality, scheme)
            self._refitted[scheme, parts] = setup.refitted(parts, near)
        return self._refitted[scheme, parts]

    def _better_known(self, search: Search) -> Searched | None:
        """What is to be searched after a look at compositions of one effect, None where it is as it
        was."""
        if self.strategy.may_be_trimmed and not self.recordings.put_aside:
            rest = self.recordings.without(unexplained_stretches(search))
            if rest is not None:
                return Searched(rest, self.quality)
        return self._with_quality_by(search)

    def _with_quality_by(self, search: Search) -> Searched | None:
        best = min(search, key=lambda c: c.total)
        quality = quality_by_residuals(self.quality, search.problem.fits, best)
        return None if quality is None else Searched(self.recordings, quality)

    def _is_enough(self, candidate: Candidate, search: Search) -> bool:
        return nothing_left(candidate, search.base, self.criteria)

    def _singles(self, search: Search) -> list[Candidate]:
        """Compositions of one effect."""
        terms = search.terms
        if self.strategy.robot:
            terms = search.suspected(search.base, self.effort.screened, self.effort.others)
        report = partial(self.progress, "one effect")
        return search.extend([search.base], terms, report, fitted=self.effort.fitted)

    def _grow(self, search: Search, generation: list[Candidate]) -> None:
        """Compositions of ever more effects after those of one, until there is nothing left to
        explain."""
        effort, largest = self.effort, self.strategy.most_effects
        for size in range(2, largest + 1):
            leaders = self._leaders(search, generation)
            if size > PAIR:
                leaders = self._exchanged(search, leaders)
                search.at_once(Search.eliminate_all, leaders[:2])
            enough = any(
                self._is_enough(c, search) and c.reduced_chi_square < self.criteria.far
                for c in search
            )
            if self._is_hopeless(search, size) or enough:
                return
            near = [c for c in leaders if not c.total > SEARCH.far_behind * leaders[0].total]
            parents = effort.parents if size == PAIR else 2
            generation = search.extend(
                near[:parents],
                search.terms,
                partial(self.progress, f"{size} effects"),
                most=effort.grown,
                fitted=effort.fitted,
                others=near[parents : parents + effort.partners],
            )
        leaders = self._leaders(search, generation)
        explains = not _left(search) > SEARCH.hopeless_pair
        if self.strategy.thorough and largest == PAIR and explains:
            leaders = self._exchanged(search, leaders)
        if self.strategy.late_topics:
            leaders = self._beside_late_topics(search, leaders)
        for c in leaders[: min(2, effort.parents)]:
            if self.strategy.robot:
                search.eliminate(c)
            else:
                search.eliminate_all(c)

    def _is_hopeless(self, search: Search, size: int) -> bool:
        """Whether so much of the gap is left that one more effect cannot explain it."""
        if size > PAIR:
            return _left(search) > SEARCH.hopeless
        return not self.strategy.thorough and _left(search) > SEARCH.hopeless_on_machine

    def _leaders(self, search: Search, generation: Sequence[Candidate]) -> list[Candidate]:
        """The best of a generation converged, the best first.

        Of a robot that is not explained yet, their effects are also tried at every joint: drives of
        one make on one bus are late, weak or sticky alike. So are aliases of the best.
        """
        leaders = self._converged(search, generation)
        explained = any(self._is_enough(c, search) for c in leaders)
        if not self.strategy.robot or explained or not leaders:
            return leaders
        by_kinds = {tuple(kind(t).name for t in c.hypothesis.effects): c for c in reversed(leaders)}
        best = list(by_kinds.values())[::-1][: SEARCH.spread]
        everywhere = [c for c in search.at_once(Search.everywhere, best) if c is not None]
        # leave out the joints at which it does not act
        search.at_once(Search.eliminate, [c for c in everywhere if self._is_enough(c, search)])
        known = set(search.candidates)
        for c in leaders[:1]:
            search.try_aliases(c)  # of two that are nearly alike one may hide what else there is
        leaders = [search.candidates[c.hypothesis] for c in leaders]
        limit = SEARCH.worth_following * leaders[0].total
        made = [c for c in everywhere if c.total < limit]
        made += [search.candidates[h] for h in search.candidates if h not in known]
        return sorted([*leaders, *(c for c in made if c.resolved)], key=lambda c: c.total)

    def _converged(self, search: Search, generation: Sequence[Candidate]) -> list[Candidate]:
        """The best of a generation, fitted until nothing moves, the best first; those far behind
        are left as they are."""
        first = generation[: self.effort.converged]
        limit = SEARCH.far_behind * max(generation[0].total, 1.0) if generation else 0.0
        near = [c for c in first if c.total < limit]
        converged = [*search.converge(near), *(c for c in first if c not in near)]
        return sorted((c for c in converged if c.resolved), key=lambda c: c.total)

    def _exchanged(self, search: Search, leaders: list[Candidate]) -> list[Candidate]:
        """The best, with those in which one of its effects gave way to another: one effect alone
        may look like what two together are not."""
        if not leaders or any(self._is_enough(c, search) for c in leaders):
            return leaders
        best = min(leaders, key=lambda c: (self._acts_everywhere(c), c.total))
        parts = [search.fitted(best.hypothesis.without(t), best) for t in best.hypothesis.effects]
        generation = search.extend(
            parts, search.terms, most=SEARCH.exchanged, fitted=self.effort.fitted
        )
        return sorted([*leaders, *self._converged(search, generation)], key=lambda c: c.total)

    def _beside_late_topics(self, search: Search, leaders: list[Candidate]) -> list[Candidate]:
        """The best, with those to which a late topic was added, and another effect to those that
        have one; where that does plainly better, each of the other effects may give way to another,
        for it was chosen without."""
        late = [t for t in search.terms if kind(t).late]
        if not leaders or any(self._is_enough(c, search) for c in leaders):
            return leaders
        with_late = [c for c in leaders[:2] if any(t in late for t in c.hypothesis.effects)]
        without = [c for c in leaders[:2] if c not in with_late]
        generation = search.extend(without, late)
        generation += search.extend(with_late, search.terms, most=SEARCH.exchanged)
        generation = self._converged(search, sorted(generation, key=lambda c: c.total))
        if generation and generation[0].total < SEARCH.beside_late * leaders[0].total:
            best = generation[0]
            others = [t for t in best.hypothesis.effects if not kind(t).late]
            parts = [search.fitted(best.hypothesis.without(t), best) for t in others]
            exchanged = search.extend(parts, search.terms, most=SEARCH.exchanged)
            generation += self._converged(search, exchanged)
        return sorted([*generation, *leaders], key=lambda c: c.total)

    def _acts_everywhere(self, candidate: Candidate) -> bool:
        return self.strategy.robot and len(candidate.hypothesis.effects) > PAIR


def is_plainly_better(one: Candidate, other: Candidate) -> bool:
    """Whether a fit leaves less than another by a good part of what is not noise, and on most
    windows."""
    if not one.total - 1.0 < SEARCH.plainly_better * (other.total - 1.0):
        return False
    costs = [c.costs for c in (one, other)]
    if len(costs[0]) != len(costs[1]):
        return True
    return bool(np.mean(costs[0] < costs[1]) > SEARCH.on_most)


def is_quiet(quality: DataQuality) -> bool:
    """Whether the noise is below what integration does."""
    seen = quality.observed
    floor = DATA_QUALITY.numerical_floor * quality.motion[seen]
    return bool((quality.noise[seen] < floor).all())


def went_astray(search: Search) -> bool:
    """Whether an effect that did well in a robot's short windows does far worse than no effect in
    its long ones: descent does not reach so far."""
    strategy, limit = search.problem.strategy, SEARCH.far_behind * search.base.fit.cost
    return strategy.in_pieces and strategy.thorough and any(c.fit.cost > limit for c in search)


def _is_promising(search: Search, best: Search) -> bool:
    """Whether the nominal form, or the best composition of another search, does much better under
    this search's scheme of integration."""
    at = min(best, key=lambda c: c.total).fit
    again = _again(search.problem, at)
    part = SEARCH.worth_following
    return again.cost < part * at.cost or search.base.total < part * best.base.total


def _again(problem: SearchProblem, at: RolloutFit) -> RolloutFit:
    """A composition fitted once more in another problem, from where it is."""
    return problem.fitter.fit(
        problem.adaptation,
        at.hypothesis,
        at.values,
        problem.fits.estimated_starts(problem.adaptation, at),
        iterations=SEARCH.fit_iterations,
        fixed=problem.fits.resting(at.values, at.hypothesis.effects),
    )


def _least_total(search: Search) -> float:
    return min(c.total for c in search)


def _left(search: Search) -> float:
    """The part of the refitted gap that the best composition so far leaves on validation
    episodes."""
    least = min(c.reduced_chi_square for c in search)
    return (least - 1.0) / max(search.base.reduced_chi_square - 1.0, 1e-12)
