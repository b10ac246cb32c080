"""Search: which compositions of effects explain the episodes, by rollout fits that grow one term at
a time: one effect at one joint.

Every term is tried on the nominal form, every other on the best of those, and so on.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeVar

import numpy as np

from trueup.diagnose.problem import SETTLE, Candidate, Problem
from trueup.diagnose.task import Race, Refine, Settle, Solve, in_threads
from trueup.diagnose.twins import twins
from trueup.fit.rollout_fit import RolloutFit, Start, in_parallel
from trueup.model.block import joint as joint_of
from trueup.model.block import kind, term
from trueup.model.effect import Port, effects
from trueup.model.hypothesis import Hypothesis

Result = TypeVar("Result")
NEARLY = 4.0  # times the misfit: a part of a composition that does about as well
PARTNERS = 2  # terms that raced best, which other parents get, and so many of their own
WON, BEATEN = (
    1.5,
    30.0,
    # misfits of a race that is over: one that leaves noise, and those that need not be fitted to
    # the end
)
RACE_SHARE = 0.5  # of the time of an extension


@dataclass
class Search:
    """Compositions found for one problem; grows as it is asked. Others than our own threads may
    `solve` its tasks."""

    problem: Problem
    terms: Sequence[str] = ()  # what is sought
    solve: Solve = in_threads
    found: dict[Hypothesis, Candidate] = field(default_factory=dict)

    def extend(
        self,
        parents: Sequence[Candidate],
        terms: Sequence[str],
        progress: Callable[[float], None] = lambda _: None,
        most: int = 0,
        settled: int = 0,
        others: Sequence[Candidate] = (),
    ) -> list[Candidate]:
        """Each parent with each term that it has not, where not fitted before; the best first.

        With `most`, only so many terms of each parent, those of which a linear model expects most;
        with `settled`, only so many of all are fitted to the end, those that did best in a race of
        their starts. `others` are parents that get few terms of their own, and those that raced
        best with the first ones: where two effects act, many may stand for the one, and the other
        is the same.
        """
        raced = self._raced(
            [(p, *found) for p in parents for found in self._promising(p, terms, most)], progress
        )
        if others:
            names = list(dict.fromkeys(name for _, name, _ in raced))[:PARTNERS]
            few = [
                (p, *found)
                for p in others
                for found in [*self._promising(p, names, 0), *self._promising(p, terms, PARTNERS)]
            ]
            already = {parent.hypothesis | name for parent, name, _ in raced}
            raced += self._raced(
                [x for x in few if x[0].hypothesis | x[1] not in already], lambda _: None
            )
            raced.sort(key=lambda found: found[2][0].cost)
        if settled and raced and raced[0][2][0].misfit < WON:
            raced = [found for found in raced if found[2][0].misfit < BEATEN]
        tasks = [
            Settle(parent.fit.cost, name, fits) for parent, name, fits in raced[: settled or None]
        ]
        done = self.solve(
            self.problem, tasks, lambda share: progress(RACE_SHARE + (1.0 - RACE_SHARE) * share)
        )
        return sorted((c for c in map(self.adopt, done) if c.resolved), key=lambda c: c.misfit)

    def _raced(
        self, wanted: Sequence[tuple[Candidate, str, np.ndarray]], progress: Callable[[float], None]
    ) -> list[tuple[Candidate, str, list[RolloutFit]]]:
        """Races of terms with parents, each composition once, the best first."""
        jobs: dict[Hypothesis, tuple[Candidate, str, np.ndarray]] = {}
        for parent, name, expected in wanted:
            jobs.setdefault(parent.hypothesis | name, (parent, name, expected))
        tasks = [Race(parent.fit, name, expected) for parent, name, expected in jobs.values()]
        raced = self.solve(self.problem, tasks, lambda share: progress(RACE_SHARE * share))
        found = [
            (parent, name, fits)
            for (parent, name, _), fits in zip(jobs.values(), raced, strict=True)
        ]
        return sorted(found, key=lambda found: found[2][0].cost)

    def _promising(
        self, parent: Candidate, names: Sequence[str], most: int
    ) -> list[tuple[str, np.ndarray]]:
        """The effects to try, with the cost that a linear model expects of each of their starts,
        the most promising first.

        On short windows: there it reaches further, for no error has grown yet.
        """
        wanted = [
            (n, parent.hypothesis | n) for n in names if not has_already(parent.hypothesis, n)
        ]
        rest = [n for n, h in wanted if h not in self.found and self.problem.fitter.has_room(h)]
        near = self.problem.near(parent.fit)
        new = [n for n in rest if n not in near.expected]
        screened = in_parallel(
            lambda name: (
                self.problem.fitter.screen(
                    self.problem.short, near.fit, name, near.linear, self.problem.starts(name)
                ).cost
            ),
            new,
        )
        near.expected.update(zip(new, screened, strict=True))
        order = [rest[i] for i in np.argsort([near.expected[n].min() for n in rest], kind="stable")]
        if most:
            order = [n for n in order if n in self.problem.evident] + _spread(
                [n for n in order if n not in self.problem.evident], most
            )
        return [(n, near.expected[n]) for n in order]

    def suspected(self, parent: Candidate, here: int, others: int) -> list[str]:
        """So many terms at the joint where a linear model expects most of one, and so many of the
        other joints', the most promising."""
        order = [name for name, _ in self._promising(parent, self.terms, 0)]
        joint = joint_of(order[0])
        chosen = [t for t in order if joint_of(t) == joint][: here or None] + [
            t for t in order if joint_of(t) != joint
        ][:others]
        return chosen + [t for t in self.problem.evident if t not in chosen]

    def everywhere(self, candidate: Candidate) -> Candidate | None:
        """The same with each of its effects at every joint where it is sought, begun there at the
        same size; None where that is no other composition, or an effect has to be sought at many
        places.
        """
        hypothesis, values = candidate.hypothesis, candidate.fit.values.copy()
        for at in candidate.hypothesis.effects:
            effect = kind(at)
            if effect.zoomed or effect.periodic or effect.port is Port.TIMING:
                return None
            rows = list(self.problem.fitter.block.rows(at))
            for t in (
                t for t in self.terms if kind(t) is effect and not has_already(hypothesis, t)
            ):
                hypothesis = hypothesis | t
                units = [
                    self.problem.fitter.unit(t, n.scale) / self.problem.fitter.unit(at, n.scale)
                    for n in effect.params
                ]
                values[list(self.problem.fitter.block.rows(t))] = values[rows] * units
        if hypothesis in self.found or hypothesis == candidate.hypothesis:
            return None
        still = self.problem.resting(values, hypothesis.effects)
        near = self.problem.fitter.fit(
            self.problem.short, hypothesis, values, iterations=SETTLE, tolerance=1e-2, fixed=still
        )
        starts = self.problem.placed(self.problem.adaptation, near)
        return self.keep(
            self.problem.fitter.fit(
                self.problem.adaptation,
                hypothesis,
                near.values,
                starts,
                iterations=SETTLE,
                tolerance=1e-3,
                fixed=still,
            )
        )

    def fitted(self, hypothesis: Hypothesis, larger: Candidate) -> Candidate:
        """A part of a composition, fitted if it was not yet."""
        if hypothesis not in self.found:
            values = larger.fit.values
            for name in set(larger.hypothesis.effects) - set(hypothesis.effects):
                values = self.problem.without(values, name)
            self.keep(
                self.problem.fitter.fit(
                    self.problem.adaptation,
                    hypothesis,
                    values,
                    larger.fit.starts,
                    iterations=SETTLE,
                )
            )
        return self.found[hypothesis]

    def at_once(
        self, work: Callable[[Search, Candidate], Result], candidates: Sequence[Candidate]
    ) -> list[Result]:
        """Work on each candidate, in threads; the answers, and what is known afterwards, do not
        depend on which thread is faster.

        Each works on a copy of what is known now. Of what they found the cheaper fit is kept, and
        of equal ones that of the candidate that comes first.
        """
        copies = [replace(self, found=dict(self.found)) for _ in candidates]
        answers = list(
            in_parallel(lambda pair: work(*pair), list(zip(copies, candidates, strict=True)))
        )
        for copy in copies:
            for candidate in copy.found.values():
                known = self.found.get(candidate.hypothesis)
                if known is None or candidate.fit.cost < known.fit.cost:
                    self.adopt(candidate)
        return answers

    def shrink(self, candidate: Candidate) -> list[Candidate]:
        """Each composition with one effect less, fitted from where this one is; kept where that is
        better than what was found."""
        better = self._smaller(candidate)
        for part in list(better):
            if len(part.hypothesis.effects) > 1 and part.misfit < NEARLY * max(
                candidate.misfit, 1.0
            ):
                better += self.shrink(part)
        return better

    def peel(self, candidate: Candidate) -> None:
        """The same with the effect left out that is missed least, again and again, while that does
        about as well."""
        while len(candidate.hypothesis.effects) > 1:
            self._smaller(candidate)
            parts = [
                self.found[candidate.hypothesis.without(name)]
                for name in candidate.hypothesis.effects
            ]
            least = min(parts, key=lambda c: c.fit.cost)
            if not least.misfit < NEARLY * max(candidate.misfit, 1.0):
                break
            candidate = least

    def _smaller(self, candidate: Candidate) -> list[Candidate]:
        """Those with one effect less that are better than what was found."""
        better = []
        for name in candidate.hypothesis.effects:
            smaller = candidate.hypothesis.without(name)
            fit = self.problem.fitter.fit(
                self.problem.adaptation,
                smaller,
                self.problem.without(candidate.fit.values, name),
                candidate.fit.starts,
                iterations=SETTLE,
                tolerance=1e-3,
            )
            if smaller not in self.found or fit.cost < self.found[smaller].fit.cost:
                better.append(self.keep(fit))
        return better

    def mirror(self, candidate: Candidate) -> None:
        """The same with each effect replaced by its twin, from the same place, fitted until nothing
        moves; kept where that is better."""
        for effect, twin in twins(candidate.hypothesis):
            if twin not in self.terms:
                continue
            rest, mirrored = (
                self.problem.without(candidate.fit.values, effect),
                candidate.hypothesis.without(effect) | twin,
            )
            ours, its = (kind(name).params[0].scale for name in (effect, twin))
            same = candidate.fit.values[
                self.problem.fitter.block.rows(effect)[0]
            ] / self.problem.fitter.unit(effect, ours)
            starts: list[tuple[float, ...]] = [(same,)] if ours is its else []
            if not starts or not len(
                self.problem.declared
            ):  # a fit of a robot takes long, and twins are as large as each other
                starts += kind(twin).starts
            begins = [self.problem.fitter.with_effect(rest, twin, start) for start in starts]
            tried = [
                self.problem.fitter.fit(
                    self.problem.adaptation,
                    mirrored,
                    b,
                    candidate.fit.starts,
                    iterations=SETTLE,
                    tolerance=1e-3,
                )
                for b in begins
            ]
            fit = min(tried, key=lambda f: f.cost)
            known = self.found.get(fit.hypothesis)
            if known is None or fit.cost < known.fit.cost:
                self.keep(self.problem.refine(self.keep(fit)).fit, candidate.check.starts)

    def refine(self, candidates: Sequence[Candidate]) -> list[Candidate]:
        """The same fitted until nothing moves."""
        return [
            self.adopt(c)
            for c in self.solve(self.problem, [Refine(c) for c in candidates], lambda _: None)
        ]

    def keep(self, fit: RolloutFit, starts: Mapping[str, Start] | None = None) -> Candidate:
        """A fit as a candidate, with the starts of validation windows estimated, from given ones
        too."""
        return self.adopt(self.problem.candidate(fit, starts))

    def adopt(self, candidate: Candidate) -> Candidate:
        """Remember a candidate as what its composition can do."""
        self.found[candidate.hypothesis] = candidate
        return candidate

    def __iter__(self) -> Iterator[Candidate]:
        return iter(sorted((c for c in self.found.values() if c.resolved), key=lambda c: c.misfit))


def has_already(hypothesis: Hypothesis, of: str) -> bool:
    """Whether a term, or one at its joint whose effect contains it or that it contains, acts."""
    here = {kind(t).name for t in hypothesis.effects if joint_of(t) == joint_of(of)}
    return (
        kind(of).name in here
        or kind(of).contains in here
        or any(effects()[other].contains == kind(of).name for other in here)
    )


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


def searchable(joints: Sequence[bool] = (True,)) -> list[str]:
    """Terms that are found by fitting, of `joints` of which each is driven or not. What acts on a
    whole log acts at the first.

    Of effects that are the same on the log of one joint, both are sought on that of several.
    """
    found = []
    for j, driven in enumerate(joints):
        for name, effect in effects().items():
            here = (driven or effect.port is not Port.COMMAND) and (
                j == 0 or effect.port is not Port.TIMING
            )
            if here and not effect.counted and not (effect.same_as and len(joints) == 1):
                found.append(term(name, j))
    return found
