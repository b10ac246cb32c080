"""Explore: how far the search goes before there is nothing left to explain."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from trueup.diagnose.admission import NUMERICAL, Admission
from trueup.diagnose.decide import SelectionCriteria, enough, total
from trueup.diagnose.laying_out import SHORTER, in_pieces, lay_out, sought
from trueup.diagnose.problem import SETTLE, Candidate, Problem
from trueup.diagnose.remainder import looked_again
from trueup.diagnose.search import Search
from trueup.diagnose.task import Solve, in_threads
from trueup.episode.episode import Episode
from trueup.fit.rollout_fit import RolloutFit, Start
from trueup.model.block import kind
from trueup.model.hypothesis import Hypothesis
from trueup.model.plant import Plant
from trueup.model.series import DECLARED, Scheme, refined, series

Progress = Callable[[str, float], None]
# of the best compositions are looked for at every joint, where they do not explain the gap at one
SPREAD = 2
HOPELESS = (
    0.25  # of the gap left by the best of a size: no effect more makes an explanation of that
)
HOPELESS_PAIR = 0.5  # the same of two effects of a robot: none in the place of one of them does
HOPELESS_ON_MACHINE = 0.6  # the same of one effect in a robot's real recording
LOOKS = 3  # at the noise, and searches, at most
FINER = 4  # steps for one of the search
PAIR = 2
SWAPPED = 5  # effects that each effect of the best may give way to
FAR_BEHIND = 4.0  # times the best misfit
SHORTENED = (
    1.0,
    0.5,
    0.25,
    0.125,
)  # of the length of windows: a cost that is too rough on whole ones
# of a robot's misfit: less is gained by no other integration, nor by an effect at every joint, that
# is worth following
HALF = 0.5
WORSE = 2.0  # times the misfit on validation episodes: a last fit that does that went astray
MANY_JOINTS = 4


@dataclass(frozen=True, slots=True)
class Effort:
    """How many go on: terms that race at the joint where a linear model expects most of one, and
    `others` beside them; of those that raced so many are `settled`, and `refined` until nothing
    moves; of the best compositions so many `parents` grow by one more term, each tried with the
    `grown` most promising, and so many `partners` that come next with a few. 0 is all, but of
    partners none.
    """

    raced: int
    others: int
    settled: int
    refined: int
    parents: int
    grown: int
    partners: int


ONE_JOINT = Effort(raced=0, others=0, settled=0, refined=5, parents=4, grown=9, partners=0)
ROBOT = Effort(raced=0, others=4, settled=5, refined=5, parents=2, grown=6, partners=4)
LARGE_ROBOT = Effort(raced=8, others=3, settled=3, refined=2, parents=1, grown=4, partners=0)


def effort(plant: Plant) -> Effort:
    """A fit of many joints takes long."""
    joints = len(plant.joints)
    return ONE_JOINT if joints == 1 else ROBOT if joints < MANY_JOINTS else LARGE_ROBOT


def explore(
    plant: Plant,
    admission: Admission,
    adaptation: Sequence[Episode],
    validation: Sequence[Episode],
    criteria: SelectionCriteria,
    progress: Progress,
    solve: Solve = in_threads,
) -> tuple[Search, Admission]:
    """The search under the scheme of integration that explains the episodes best, and what the
    episodes are like, noise looked at again."""
    for _ in range(LOOKS):
        search, again = _explored(
            plant, admission, adaptation, validation, criteria, progress, solve
        )
        if again is None:
            break
        admission = again
    return search, admission


def _explored(
    plant: Plant,
    admission: Admission,
    adaptation: Sequence[Episode],
    validation: Sequence[Episode],
    criteria: SelectionCriteria,
    progress: Progress,
    solve: Solve,
) -> tuple[Search, Admission | None]:
    """One search; and where its noise turns out to be another, what the episodes are like with
    that."""

    def laid_out(scheme: Scheme, parts: int) -> Search:
        problem, base = lay_out(plant, admission, adaptation, validation, criteria, scheme, parts)
        progress("the nominal form refitted", 1.0)
        return Search(problem, sought(plant), solve, {Hypothesis(): base})

    schemes = [refined(plant), DECLARED]
    if criteria.of_machine:
        schemes = schemes[:1]  # a machine has no step
    elif quiet(admission):
        schemes.reverse()  # a log without noise is a simulator's, and its step is the declared one
    best: Search | None = None
    parts = 1
    for scheme in schemes:
        search = laid_out(scheme, parts)
        if best is not None and len(plant.joints) > 1 and not _promises(search, best):
            break
        generation = _first(plant, search, progress)
        again = (
            looked_again(admission, search.problem, min(search, key=total))
            if best is None
            else None
        )
        if again is not None:
            return search, again
        if best is None and _astray(search):
            parts = SHORTER
            search = laid_out(scheme, parts)
            generation = _first(plant, search, progress)
        _grow(plant, search, generation, criteria, progress)
        if best is None or min(map(total, search)) < min(map(total, best)):
            best = search
        if any(enough(c, search.found[Hypothesis()], criteria) for c in search):
            break
    assert best is not None
    return best, looked_again(admission, best.problem, min(best, key=total))


def _promises(search: Search, best: Search) -> bool:
    """Whether the nominal form, or the best composition of another search, does much better under a
    robot's search's own scheme."""
    winner = min(best, key=total)
    at, base = winner.fit, Hypothesis()
    problem = search.problem
    data = problem.adaptation
    again = problem.fitter.fit(
        data,
        at.hypothesis,
        at.values,
        problem.placed(data, at),
        iterations=SETTLE,
        fixed=problem.still(at),
    )
    return again.cost < HALF * at.cost or total(search.found[base]) < HALF * total(best.found[base])


def quiet(admission: Admission) -> bool:
    """Whether the noise is below what integration does."""
    seen = admission.observed
    return bool((admission.noise[seen] < NUMERICAL * admission.motion[seen]).all())


def _first(plant: Plant, search: Search, progress: Progress) -> list[Candidate]:
    """Compositions of one effect."""
    base, spent = search.found[Hypothesis()], effort(plant)
    terms = (
        search.terms
        if len(plant.joints) == 1
        else search.suspected(base, spent.raced, spent.others)
    )
    return search.extend([base], terms, partial(progress, "one effect"), settled=spent.settled)


def _astray(search: Search) -> bool:
    """Whether an effect that did well in a robot's short windows ends far behind none in its long
    ones: descent does not reach so far."""
    base = search.found[Hypothesis()]
    return (
        len(search.problem.pieces) > 0
        and search.problem.exact
        and any(c.fit.cost > FAR_BEHIND * base.fit.cost for c in search)
    )


def _grow(
    plant: Plant,
    search: Search,
    generation: list[Candidate],
    criteria: SelectionCriteria,
    progress: Progress,
) -> None:
    """Compositions of ever more effects after those of one, until there is nothing left to
    explain."""
    alone, base, spent = len(plant.joints) == 1, search.found[Hypothesis()], effort(plant)
    largest = criteria.most_effects if alone else PAIR
    for size in range(2, largest + 1):
        leaders = _leaders(search, generation, base, criteria, spent)
        if size > PAIR:  # one effect less than two is what the others began from
            leaders = _swapped(search, leaders, base, criteria, spent)
            search.at_once(Search.shrink, leaders[:2])
        left = _left(search, base)
        hopeless = (
            left > HOPELESS
            if size > PAIR
            else left > HOPELESS_ON_MACHINE and not search.problem.exact
        )
        if hopeless or any(enough(c, base, criteria) and c.misfit < criteria.far for c in search):
            return
        near = [c for c in leaders if not total(c) > FAR_BEHIND * total(leaders[0])]
        many, says = spent.parents if size == PAIR else 2, partial(progress, f"{size} effects")
        others = near[many : many + spent.partners]
        generation = search.extend(
            near[:many], search.terms, says, most=spent.grown, settled=spent.settled, others=others
        )
    leaders = _leaders(search, generation, base, criteria, spent)
    if largest == PAIR and search.problem.exact and not _left(search, base) > HOPELESS_PAIR:
        leaders = _swapped(search, leaders, base, criteria, spent)
    for c in leaders[: min(2, spent.parents)]:
        (search.shrink if alone else search.peel)(c)


def _left(search: Search, base: Candidate) -> float:
    """The part of the refitted gap that the best composition so far leaves on validation
    episodes."""
    return (min(c.misfit for c in search) - 1.0) / max(base.misfit - 1.0, 1e-12)


def polished(
    plant: Plant,
    problem: Problem,
    best: Candidate,
    adaptation: Sequence[Episode],
    validation: Sequence[Episode],
    criteria: SelectionCriteria,
) -> tuple[Candidate, Scheme, RolloutFit]:
    """The answer fitted once more on every sample and on finer steps, so that integration leaves no
    mark on its estimates; its scheme, and the same fitted on other steps.

    Where its cost on whole windows is so rough that no minimum can be proven, on shorter ones, in
    which errors grow less. A machine's windows are those of its predictions: there the search's own
    fit does, where it is proven, or where it predicts better.
    """
    scheme, physical = problem.scheme, criteria.of_machine
    if scheme.alpha == 0.0 and not physical:
        return best, scheme, best.fit
    finer = Scheme(scheme.alpha, FINER * scheme.parts) if scheme.alpha and problem.exact else scheme
    found: list[Candidate] = []
    for part in SHORTENED if len(plant.joints) == 1 and not physical else SHORTENED[:1]:
        last = _last(
            plant, problem, adaptation, validation, criteria, finer, problem.length_s * part
        )
        done = _finished(last, problem, best)
        before = (
            last.candidate(best.fit).misfit if physical else best.misfit
        )  # from where the log says, or from where fits best
        if done is not None and done.misfit < WORSE * before:
            found.append(done)
        if found and found[-1].fit.proven:
            break
    proven = [c for c in (*found, best) if c.fit.proven]
    fair = [c for c in found if not physical or c.misfit < before]
    answer = [*proven, *fair, best][0]
    return (
        answer,
        scheme if answer is best else finer,
        found[0].fit if found and answer is best else best.fit,
    )


def _last(
    plant: Plant,
    problem: Problem,
    adaptation: Sequence[Episode],
    validation: Sequence[Episode],
    criteria: SelectionCriteria,
    scheme: Scheme,
    length_s: float,
) -> Problem:
    """A problem of every sample in windows of a length [s] under a scheme.

    On a machine the windows start where the log says: what no law explains must not hide in their
    starts.
    """
    several = len(plant.joints) > 1 and problem.exact
    return Problem(
        problem.fitter.holding() if criteria.of_machine else problem.fitter,
        [series(plant, e, scheme, length_s) for e in adaptation],
        [series(plant, e, scheme, length_s) for e in validation],
        problem.short,
        declared=problem.declared,
        pieces=in_pieces(plant, [*adaptation, *validation], scheme, length_s) if several else {},
    )


def _finished(last: Problem, problem: Problem, best: Candidate) -> Candidate | None:
    """The answer of a problem taken to its minimum on the last one; None where it runs away
    there."""
    if last.pieces:
        starts = last.placed(last.adaptation, best.fit)
    else:
        starts = {
            s.digest: Start(s.begin, best.fit.starts[s.digest].memory) for s in last.adaptation
        }
    fit = last.fitter.fit(
        last.adaptation,
        best.hypothesis,
        best.fit.values,
        starts,
        iterations=25,
        tolerance=1e-7 if problem.exact else 1e-4,
        fixed=problem.still(best.fit),
    )
    if not np.isfinite(fit.cost):
        return None
    return last.converged(fit if last.fitter.held else last.pruned(fit))


def _refined(search: Search, generation: Sequence[Candidate], most: int) -> list[Candidate]:
    """The best of a generation, fitted until nothing moves, the best first; those far behind are
    left as they are."""
    near = [c for c in generation[:most] if total(c) < FAR_BEHIND * max(total(generation[0]), 1.0)]
    refined = [*search.refine(near), *(c for c in generation[:most] if c not in near)]
    return sorted((c for c in refined if c.resolved), key=total)


def _leaders(
    search: Search,
    generation: Sequence[Candidate],
    base: Candidate,
    criteria: SelectionCriteria,
    spent: Effort,
) -> list[Candidate]:
    """The best of a generation refined, with those in which their effects act at every joint where
    that is still wanted: drives of one make on one bus are late, weak or sticky alike.
    """
    leaders = _refined(search, generation, spent.refined)
    if spent is ONE_JOINT or any(enough(c, base, criteria) for c in leaders):
        return leaders
    best = list(
        {tuple(kind(t).name for t in c.hypothesis.effects): c for c in reversed(leaders)}.values()
    )[::-1][:SPREAD]
    made = [c for c in search.at_once(Search.everywhere, best) if c is not None]
    search.at_once(
        Search.peel, [c for c in made if enough(c, base, criteria)]
    )  # at how many of them does it act?
    known = set(search.found)
    for c in leaders[:1]:
        search.mirror(c)  # of two that are nearly alike one may hide what else there is
    leaders = [search.found[c.hypothesis] for c in leaders]
    made = [c for c in made if total(c) < HALF * total(leaders[0])] + [
        search.found[h] for h in search.found if h not in known
    ]
    return sorted([*leaders, *(c for c in made if c.resolved)], key=total)


def _swapped(
    search: Search,
    leaders: list[Candidate],
    base: Candidate,
    criteria: SelectionCriteria,
    spent: Effort,
) -> list[Candidate]:
    """The best, with those in which one of its effects gave way to another: one effect alone may
    look like what two together are not."""
    if not leaders or any(enough(c, base, criteria) for c in leaders):
        return leaders
    best = min(
        leaders,
        key=lambda c: (
            len(c.hypothesis.effects) > PAIR and len(search.problem.declared) > 0,
            total(c),
        ),
    )
    parts = [search.fitted(best.hypothesis.without(name), best) for name in best.hypothesis.effects]
    generation = search.extend(parts, search.terms, most=SWAPPED, settled=spent.settled)
    return sorted([*leaders, *_refined(search, generation, spent.refined)], key=total)
