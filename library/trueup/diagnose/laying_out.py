"""Lay out: from a plant and its episodes to the problem of a search: a scheme of integration,
windows, and the nominal form refitted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from trueup.diagnose.admission import Admission
from trueup.diagnose.decide import SelectionCriteria, total
from trueup.diagnose.periodicity import pitches
from trueup.diagnose.problem import Candidate, Problem
from trueup.diagnose.search import searchable
from trueup.episode.episode import Episode
from trueup.episode.role import Role
from trueup.fit.base_parameters import directions
from trueup.fit.identify import identify
from trueup.fit.rollout_fit import Fitter, RolloutFit
from trueup.model.block import joint, kind
from trueup.model.plant import Plant
from trueup.model.rounding import GUESS_BITS, rounded
from trueup.model.series import Scheme, Series, series

WINDOW_S = 2.0
SHORT_S = 0.5  # windows for beginnings,
# of a robot so many in one that is fitted: the further the nominal form is off, the shorter a
# linear model reaches
SHORTER = 4
HALVED = 3  # times at most, windows in which the nominal form runs away
SHORTEST = 16  # samples, and no fewer: noise is all that a window of less would show
TELLING = 2  # episodes on which they race
TELLING_ROWS = 15_000  # samples of all joints that they race on, at most
# in all adaptation episodes; more than twice as many are thinned where they are close together
ENOUGH_SAMPLES = 6000
FINE = 0.02  # of the time in which the joint crosses its travel: a step that still integrates well
# of the force that is missing at a robot's joint: what repeats with the position and is so much of
# it races in any case
EVIDENT = 0.3


def by_role(episodes: Sequence[Episode]) -> tuple[list[Episode], list[Episode]]:
    """Those that are fitted and those that compare, in an order of their own: however they were
    handed in, the report is the same."""
    ordered = sorted(episodes, key=lambda e: e.digest)
    return [e for e in ordered if e.role is Role.ADAPTATION], [
        e for e in ordered if e.role is Role.VALIDATION
    ]


def lay_out(
    plant: Plant,
    admission: Admission,
    adaptation: Sequence[Episode],
    validation: Sequence[Episode],
    criteria: SelectionCriteria,
    scheme: Scheme,
    parts: int,
) -> tuple[Problem, Candidate]:
    """A problem, and the nominal form refitted, on windows of which so many `parts` make one of
    full length, or more where the nominal form runs away.
    """
    length_s = window_s(plant, [*adaptation, *validation], criteria) / parts
    adaptation, validation = taken(admission, adaptation, validation, scheme)
    begins = _begins(plant, adaptation)
    for part_s in length_s / 2.0 ** np.arange(HALVED + 1):
        problem = _in_windows(
            plant, admission, adaptation, validation, criteria, scheme, float(part_s)
        )
        base = problem.refitted(begins)
        if np.isfinite(total(base)):
            break
    return _furnished(plant, admission, adaptation, validation, criteria, problem, base.fit), base


def laid_out(
    plant: Plant,
    admission: Admission,
    adaptation: Sequence[Episode],
    validation: Sequence[Episode],
    criteria: SelectionCriteria,
    scheme: Scheme,
    length_s: float,
    base: RolloutFit,
) -> Problem:
    """The same problem once more, from what was found in laying it out: the windows' length [s] and
    the nominal form refitted."""
    adaptation, validation = taken(admission, adaptation, validation, scheme)
    problem = _in_windows(plant, admission, adaptation, validation, criteria, scheme, length_s)
    return _furnished(plant, admission, adaptation, validation, criteria, problem, base)


def taken(
    admission: Admission,
    adaptation: Sequence[Episode],
    validation: Sequence[Episode],
    scheme: Scheme,
) -> tuple[Sequence[Episode], Sequence[Episode]]:
    """The episodes that are fitted and those that compare, thinned under a scheme whose steps need
    not be the log's."""
    if not scheme.alpha:
        return adaptation, validation
    every = thinning(admission, adaptation)
    return [thinned(e, every) for e in adaptation], [thinned(e, every) for e in validation]


def _in_windows(
    plant: Plant,
    admission: Admission,
    adaptation: Sequence[Episode],
    validation: Sequence[Episode],
    criteria: SelectionCriteria,
    scheme: Scheme,
    length_s: float,
) -> Problem:
    """What is fitted to windows of a length [s]."""
    return Problem(
        Fitter(
            plant.form,
            directions(plant, adaptation),
            admission.scales,
            admission.sigma,
            admission.correlation,
            held=len(plant.joints) == 1 and criteria.of_machine,
        ),
        [series(plant, e, scheme, length_s) for e in adaptation],
        [series(plant, e, scheme, length_s) for e in validation],
        [series(plant, e, scheme, min(SHORT_S, length_s)) for e in adaptation],
        length_s,
    )


def _furnished(
    plant: Plant,
    admission: Admission,
    adaptation: Sequence[Episode],
    validation: Sequence[Episode],
    criteria: SelectionCriteria,
    problem: Problem,
    base: RolloutFit,
) -> Problem:
    """The same with what a search of terms needs."""
    alone, scheme = len(plant.joints) == 1, problem.scheme
    repeating = {
        t: pitches(plant, admission, joint(t), adaptation)
        for t in sought(plant)
        if kind(t).periodic
    }
    problem = replace(
        problem,
        base=base,
        pitches={t: begins for t, (begins, _) in repeating.items()},
        evident=[t for t, (_, part) in repeating.items() if part > EVIDENT and not alone],
        exact=alone or not criteria.of_machine,
    )
    if alone:
        return problem
    short_s = min(
        SHORT_S, max(problem.length_s / SHORTER, SHORTEST * max(e.period_s for e in adaptation))
    )
    return replace(
        problem,
        short=[
            series(plant, e, scheme, short_s) for e in _telling(base, adaptation, len(plant.joints))
        ],
        declared=plant.parameters,
        pieces=in_pieces(plant, [*adaptation, *validation], scheme, problem.length_s),
    )


def in_pieces(
    plant: Plant, episodes: Sequence[Episode], scheme: Scheme, length_s: float
) -> dict[str, Series]:
    """A robot's windows of a length [s] in pieces, in which their starts are found, by episode
    digest."""
    return {e.digest: series(plant, e, scheme, length_s, SHORTER) for e in episodes}


def sought(plant: Plant) -> list[str]:
    """Terms that are found by fitting a plant."""
    return searchable([bool(c >= 0) for c in plant.command_columns])


def window_s(plant: Plant, episodes: Sequence[Episode], criteria: SelectionCriteria) -> float:
    """Length of the windows that are fitted [s]: the horizon of evaluation on a machine, whose
    disturbances no model foresees, and of a robot, which soon goes its own way; else two seconds at
    least.
    """
    shortest = min(float(e.t_s[-1]) for e in episodes)
    given = len(plant.joints) > 1 or criteria.of_machine
    return min(plant.horizon_s if given else max(WINDOW_S, plant.horizon_s), shortest)


def _begins(plant: Plant, adaptation: Sequence[Episode]) -> list[Sequence[float]]:
    """Parameters from which the nominal form is fitted: the declared ones, and of a robot those of
    a regression."""
    if len(plant.joints) == 1:
        return [plant.parameters]
    return [
        plant.parameters,
        rounded(np.array(identify(plant, adaptation)[0].parameters), GUESS_BITS),
    ]


def _telling(base: RolloutFit, episodes: Sequence[Episode], joints: int) -> list[Episode]:
    """Where terms of a robot race: the episodes that the nominal form explains worst, and of a long
    one the stretch that it does."""
    by_episode = base.by_episode
    worst = sorted(episodes, key=lambda e: -by_episode[e.digest])[:TELLING]
    most = TELLING_ROWS // (len(worst) * joints)
    ends = np.cumsum([len(s.windows) for s in base.starts.values()])
    costs = dict(zip(base.starts, np.split(base.costs, ends[:-1]), strict=True))
    return [_stretch(e, costs[e.digest], most) for e in worst]


def _stretch(episode: Episode, costs: np.ndarray, most: int) -> Episode:
    """No more than so many samples of an episode that follow each other, those whose windows cost
    most `(windows,)`."""
    samples = len(episode.t_s)
    if samples <= most:
        return episode
    many = max(1, int(len(costs) * most / samples))
    first = int(np.argmax(np.convolve(costs, np.ones(many), "valid"))) * samples // len(costs)
    kept = slice(min(first, samples - most), min(first, samples - most) + most)
    t = episode.t_s[kept] - episode.t_s[kept][0]
    # its hidden states begin elsewhere
    cut = f"{episode.digest}, samples {kept.start} to {kept.stop}"
    return replace(
        episode,
        t_s=t,
        commands=episode.commands[kept].copy(),
        observations=episode.observations[kept].copy(),
        digest=cut,
    )


def thinning(admission: Admission, episodes: Sequence[Episode]) -> int:
    """How many samples become one, where there are many and they follow each other much faster than
    the motion."""
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
    return replace(
        episode,
        t_s=episode.t_s[kept].copy(),
        commands=commands,
        observations=episode.observations[kept].copy(),
    )
