"""Explore: how far the search goes before there is nothing left to explain."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from trueup.diagnose.admission import NUMERICAL, Admission
from trueup.diagnose.decide import PHYSICAL, Yardstick, enough, total, yardstick
from trueup.diagnose.periodicity import pitches
from trueup.diagnose.search import Candidate, Search, searchable
from trueup.episode.episode import Episode
from trueup.fit.base_parameters import directions
from trueup.fit.rollout_fit import Fitter, Start, in_parallel
from trueup.model.block import kind
from trueup.model.hypothesis import Hypothesis
from trueup.model.plant import Plant
from trueup.model.series import DECLARED, Scheme, Series, refined, series
from trueup.model.state import smoothed_states

Progress = Callable[[str, float], None]
PARENTS = 4  # of the best compositions grow by one more effect
REFINED = 5  # of the best are fitted until nothing moves
WINDOW_S = 2.0
SHORT_S = 0.5  # windows for beginnings
GROWN = 9  # effects that each of them is tried with, of those that a linear model expects most of
SETTLED = 5  # terms of a robot of several joints that are fitted to the end, of those that did best in a race
OTHERS = 6  # terms that race beside all of the joint that is suspected most, and beside each of the best
HALVED = 3  # times at most, windows in which the nominal form runs away
FEW = 2  # of the best compositions of a robot grow by one more term
TELLING = 2  # episodes on which they race
HOPELESS = 0.25  # of the gap left by the best of a size: no effect more makes an explanation of that
ENOUGH_SAMPLES = 6000  # in all adaptation episodes; more than twice as many are thinned where they are close together
FINE = 0.02  # of the time in which the joint crosses its travel: a step that still integrates well
FINER = 4  # steps for one of the search
PAIR = 2
SWAPPED = 5  # effects that each effect of the best may give way to
FAR_BEHIND = 4.0  # times the best misfit


def explore(plant: Plant, admission: Admission, adaptation: Sequence[Episode], validation: Sequence[Episode], progress: Progress) -> Search:
    """The search under the scheme of integration that explains the episodes best."""
    schemes = [refined(plant), DECLARED]
    if yardstick(adaptation) is PHYSICAL:
        schemes = schemes[:1]  # a machine has no step
    elif quiet(admission):
        schemes.reverse()  # a log without noise is a simulator's, and its step is the declared one
    best: Search | None = None
    for scheme in schemes:
        search = _explore(plant, admission, adaptation, validation, scheme, progress)
        if best is None or min(map(total, search)) < min(map(total, best)):
            best = search
        if any(enough(c, search.found[Hypothesis()], yardstick(adaptation)) for c in search):
            break
    assert best is not None
    return best


def quiet(admission: Admission) -> bool:
    """Whether the noise is below what integration does."""
    seen = admission.observed
    return bool((admission.noise[seen] < NUMERICAL * admission.motion[seen]).all())


def window_s(plant: Plant, episodes: Sequence[Episode]) -> float:
    """Length of the windows that are fitted [s]: the horizon of evaluation on a machine, whose disturbances no model foresees, and of a
    robot, which soon goes its own way; else two seconds at least.
    """
    shortest = min(float(e.t_s[-1]) for e in episodes)
    given = len(plant.joints) > 1 or yardstick(episodes) is PHYSICAL
    return min(plant.horizon_s if given else max(WINDOW_S, plant.horizon_s), shortest)


def _explore(
    plant: Plant, admission: Admission, adaptation: Sequence[Episode], validation: Sequence[Episode], scheme: Scheme, progress: Progress
) -> Search:
    length = window_s(plant, [*adaptation, *validation])
    if scheme.alpha:
        every = thinning(admission, adaptation)
        adaptation, validation = ([thinned(e, every) for e in group] for group in (adaptation, validation))
    fitter = Fitter(plant.form, directions(plant, adaptation), admission.scales, admission.sigma)
    for parts in 2 ** np.arange(HALVED + 1):
        search = Search(
            fitter,
            [series(plant, e, scheme, length / parts) for e in adaptation],
            [series(plant, e, scheme, length / parts) for e in validation],
            [series(plant, e, scheme, min(SHORT_S, length / parts)) for e in adaptation],
        )
        base, by = search.base(plant.parameters), yardstick(adaptation)
        if np.isfinite(total(base)):
            break
    search.length_s = length / float(parts)
    search.terms = searchable([bool(c >= 0) for c in plant.command_columns])
    search.pitches = pitches(plant, admission, adaptation)
    progress("the nominal form refitted", 1.0)
    alone = len(plant.joints) == 1
    if not alone:
        search.short, search.declared = _telling(base, search.short), plant.parameters
    settled = 0 if alone else SETTLED
    terms = search.terms if alone else search.suspected(base, OTHERS)
    generation = search.extend([base], terms, partial(progress, "one effect"), settled=settled)
    largest, kept = (by.most_effects, PARENTS) if alone else (PAIR, FEW)
    for size in range(2, largest + 1):
        leaders = _refined(search, generation)
        if size > PAIR:  # one effect less than two is what the others began from
            leaders = _swapped(search, leaders, base, by, settled)
            list(in_parallel(search.shrink, leaders[:2]))
        best = min(c.misfit for c in search)
        if any(enough(c, base, by) for c in search) or (size > PAIR and best - 1.0 > HOPELESS * (base.misfit - 1.0)):
            break
        parents = leaders[: kept if size == PAIR else 2]
        generation = search.extend(
            parents, search.terms, partial(progress, f"{size} effects"), most=GROWN if alone else OTHERS, settled=settled
        )
    else:
        leaders = _refined(search, generation)
        for c in (_swapped(search, leaders, base, by, settled) if largest == PAIR and alone else leaders)[:2]:
            search.shrink(c)
    return search


def polished(
    plant: Plant, admission: Admission, search: Search, best: Candidate, adaptation: Sequence[Episode], validation: Sequence[Episode]
) -> tuple[Candidate, Scheme]:
    """The answer fitted once more on every sample and on finer steps, so that integration leaves no mark on its estimates.

    On a machine the windows start where the log says: what no law explains must not hide in their starts.
    """
    scheme = search.adaptation[0].scheme
    physical = yardstick(adaptation) is PHYSICAL
    if scheme.alpha == 0.0 and not physical:
        return best, scheme
    finer = Scheme(scheme.alpha, FINER * scheme.parts) if scheme.alpha else scheme
    length = search.length_s
    last = Search(
        search.fitter,
        [_started(plant, e, series(plant, e, finer, length), best) for e in adaptation],
        [series(plant, e, finer, length) for e in validation],
        search.short,
    )
    starts = {s.digest: Start(s.begin, best.fit.starts[s.digest].memory) for s in last.adaptation}
    fit = last.fitter.fit(
        last.adaptation,
        best.hypothesis,
        best.fit.values,
        starts,
        iterations=25,
        tolerance=1e-7,
        hold_starts=physical,
        fixed=search.still(best.fit),
    )
    return last.keep(fit if physical else last.pruned(fit)), finer


def _started(plant: Plant, episode: Episode, s: Series, best: Candidate) -> Series:
    """A series whose windows start from positions alone where an effect of the composition hides the velocity."""
    hidden = any(kind(t).hides_velocity for t in best.hypothesis.effects)
    return replace(s, begin=smoothed_states(plant, episode, from_positions=True)[np.flatnonzero(s.resets >= 0)]) if hidden else s


def _refined(search: Search, generation: Sequence[Candidate]) -> list[Candidate]:
    """The best of a generation, fitted until nothing moves, the best first; those far behind are left as they are."""
    near = [c for c in generation[:REFINED] if total(c) < FAR_BEHIND * max(total(generation[0]), 1.0)]
    refined = [*in_parallel(search.refine, near), *(c for c in generation[:REFINED] if c not in near)]
    return sorted((c for c in refined if c.resolved), key=total)


def _telling(base: Candidate, short: Sequence[Series]) -> list[Series]:
    """The episodes on which terms of a robot race: those that the nominal form explains worst."""
    by_episode = base.fit.by_episode
    return sorted(short, key=lambda s: -by_episode[s.digest])[:TELLING]


def _swapped(search: Search, leaders: list[Candidate], base: Candidate, by: Yardstick, settled: int = 0) -> list[Candidate]:
    """The best, with those in which one of its effects gave way to another: one effect alone may look like what two together are not."""
    if not leaders or any(enough(c, base, by) for c in leaders):
        return leaders
    parts = [search.fitted(leaders[0].hypothesis.without(name), leaders[0]) for name in leaders[0].hypothesis.effects]
    return sorted([*leaders, *_refined(search, search.extend(parts, search.terms, most=SWAPPED, settled=settled))], key=total)


def thinning(admission: Admission, episodes: Sequence[Episode]) -> int:
    """How many samples become one, where there are many and they follow each other much faster than the motion."""
    many = sum(len(e.t_s) for e in episodes) // ENOUGH_SAMPLES
    crossing = min(s.position / s.velocity for s in admission.scales)
    fast = int(FINE * crossing / max(e.period_s for e in episodes))
    return max(1, min(many, fast))


def thinned(episode: Episode, every: int) -> Episode:
    """Each `every`-th sample of an episode, with the mean of the commands in between."""
    if every == 1:
        return episode
    kept = slice(0, len(episode.t_s), every)
    spans = np.diff(episode.t_s, append=2.0 * episode.t_s[-1] - episode.t_s[-2])[:, None]
    starts = np.arange(0, len(episode.t_s), every)
    commands = np.add.reduceat(episode.commands * spans, starts) / np.add.reduceat(spans, starts)
    return replace(episode, t_s=episode.t_s[kept].copy(), commands=commands, observations=episode.observations[kept].copy())
