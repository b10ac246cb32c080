"""Diagnosis: from a plant and its episodes to a verdict, the corrected predictor, and a report."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

from trueup.canonical import Json
from trueup.collect.bounds import Recorded
from trueup.diagnose.admission import admit
from trueup.diagnose.decide import Choice, SelectionCriteria, agreeing, decide, selection_criteria
from trueup.diagnose.explain import alternative, bounds, estimates, parameter_table, shares
from trueup.diagnose.explore import explore, polished
from trueup.diagnose.filtering import corrected
from trueup.diagnose.laying_out import by_role
from trueup.diagnose.locate import locate
from trueup.diagnose.measure import Gap, measure
from trueup.diagnose.noise import Noise
from trueup.diagnose.probe import Experiment, next_experiment
from trueup.diagnose.remainder import noise_level
from trueup.diagnose.report import report
from trueup.diagnose.search import Search
from trueup.diagnose.task import Solve, in_threads
from trueup.episode.episode import Episode
from trueup.errors import NotIdentifiable
from trueup.fit.rollout_fit import RolloutFit, in_parallel
from trueup.model.corrected import Corrected
from trueup.model.hypothesis import Hypothesis
from trueup.model.mjcf_patch import Patch, patch
from trueup.model.plant import Plant
from trueup.model.predictor import Nominal

Progress = Callable[[str, float], None]
ROUNDS = 4  # at most, until what a choice names is what was fitted to the end
TWICE = 2  # a twin that turns out better shows its own twin a better place


@dataclass(frozen=True)
class Diagnosis:
    """A verdict with everything that it rests on.

    `document` is the report as JSON; `predictor` the corrected model, `patch` the same as changes
    to a robot's MJCF.
    """

    document: Mapping[str, Json]
    predictor: Corrected
    patch: Patch
    plant: Plant
    validation: Sequence[Episode]
    gap: Gap
    choice: Choice
    experiment: Experiment | None
    search: Search
    nominal: RolloutFit


def _decided(search: Search, nominal: RolloutFit, criteria: SelectionCriteria) -> Choice:
    """The choice among what was found."""
    return decide(list(search), nominal, criteria, partial(noise_level, search.problem))


def _settled(
    search: Search, choice: Choice, nominal: RolloutFit, criteria: SelectionCriteria
) -> Choice:
    """The choice once the fits of all that it names stand at their minima: a better fit of one may
    unseat another.

    Of a robot the alternatives' alone, for the answer is fitted once more anyway, on finer steps.
    """
    if len(search.problem.declared):
        return replace(
            choice,
            rivals=tuple(search.adopt(search.problem.converged(c.fit)) for c in choice.rivals),
        )
    done: set[Hypothesis] = set()
    for _ in range(ROUNDS):
        wanted = [
            c
            for c in (search.found[Hypothesis()], choice.winner, *choice.rivals)
            if c.hypothesis not in done
        ]
        if not wanted:
            break
        for converged in in_parallel(
            lambda c: search.problem.converged(c.fit),
            list({c.hypothesis: c for c in wanted}.values()),
        ):
            done.add(converged.hypothesis)
            search.adopt(converged)
        choice = _decided(search, nominal, criteria)
    return choice


def diagnose(
    plant: Plant,
    episodes: Sequence[Episode],
    seed: int = 0,
    progress: Progress = lambda _stage, _part: None,
    solve: Solve = in_threads,
) -> Diagnosis:
    """Diagnose the gap between a nominal model and recorded episodes.

    Adaptation episodes are fitted; validation episodes compare and measure. Raises NotIdentifiable
    where there are none of either, or where the joint never moves. The tasks of the search are done
    by whoever may `solve` them; the answer is the same.
    """
    adaptation, validation = by_role(episodes)
    if not validation:
        raise NotIdentifiable(
            "there is no validation episode to compare on",
            hint="Give at least one episode the role validation.",
        )
    progress("looking at the episodes", 0.0)
    admission = admit(plant, adaptation)
    criteria = selection_criteria(plant, [*adaptation, *validation])
    search, admission = explore(plant, admission, adaptation, validation, criteria, progress, solve)
    problem = search.problem
    nominal = problem.nominal(plant.parameters)
    choice = _decided(search, nominal, criteria)
    for _ in range(TWICE):
        search.mirror(choice.winner)
        choice = _decided(search, nominal, criteria)
    choice = _settled(search, choice, nominal, criteria)
    progress("measuring on held-out episodes", 0.0)
    base = search.found[Hypothesis()]
    best, scheme, other = polished(plant, problem, choice.winner, adaptation, validation, criteria)
    predictor = corrected(plant, admission, best.fit, scheme, adaptation)
    refitted = corrected(plant, admission, base.fit, problem.scheme, adaptation)
    gap = measure(
        Nominal(plant),
        refitted,
        predictor,
        validation,
        Noise(admission.noise, admission.correlation),
        seed,
    )
    choice = agreeing(choice, gap)
    progress("what the data speak against", 0.0)
    excluded, unexcited = bounds(search, choice.winner, plant)
    experiment = next_experiment(plant, admission, search, choice, Recorded.of(plant, adaptation))
    changes = patch(predictor)
    document = report(
        plant=plant,
        admission=admission,
        search=search,
        choice=choice,
        answer=best,
        nominal=nominal,
        gap=gap,
        effects=estimates(
            best.minima, other, problem.fitter, plant, shares(search, choice, nominal)
        ),
        alternatives=[alternative(plant, search, rival) for rival in choice.rivals],
        patch=changes,
        parameters=parameter_table(plant, problem.fitter.directions, best.minima, other),
        excluded=excluded,
        unexcited=unexcited,
        where=locate(plant, search, choice.winner, nominal, adaptation, validation),
        experiment=experiment,
        episodes=episodes,
        seed=seed,
    )
    progress("done", 1.0)
    return Diagnosis(
        document, predictor, changes, plant, validation, gap, choice, experiment, search, nominal
    )
