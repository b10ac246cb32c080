"""Diagnosis: from a plant and its episodes to a verdict, the corrected predictor, and a report."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

from trueup.artifact.artifact import Artifact, pack
from trueup.canonical import Json
from trueup.collect.bounds import Recorded
from trueup.cores import in_parallel
from trueup.diagnose.between_recordings import Agreement, agreement
from trueup.diagnose.bounds import bounds
from trueup.diagnose.by_prediction import (
    Predictors,
    best_of_the_alike,
    fallback,
    nominal_predictor,
    predicts_worse,
    without_idle,
)
from trueup.diagnose.data_quality import assess
from trueup.diagnose.explain import alternative, estimates, parameter_table, shares
from trueup.diagnose.explore import explore
from trueup.diagnose.final_refit import FinalRefit, final_refit
from trueup.diagnose.identifiability import identifiability
from trueup.diagnose.intervals import Minima
from trueup.diagnose.locate import locate
from trueup.diagnose.measure import Gap, measure
from trueup.diagnose.model_selection import Choice, Conclusion, agreeing, select
from trueup.diagnose.next_experiment import Experiment, next_experiment
from trueup.diagnose.noise import Noise
from trueup.diagnose.payload import payload
from trueup.diagnose.problem_setup import Recordings
from trueup.diagnose.report import Served, report
from trueup.diagnose.residual_noise import noise_level
from trueup.diagnose.search import Search
from trueup.diagnose.second_look import certain_of_the_rest, second_look
from trueup.diagnose.tasks import Solve, in_threads
from trueup.diagnose.tuning import SEARCH
from trueup.episode.episode import Episode
from trueup.fit.rollout_fit import RolloutFit
from trueup.model.corrected import Corrected
from trueup.model.hypothesis import Hypothesis
from trueup.model.mjcf_patch import Patch, patch
from trueup.model.plant import Plant
from trueup.model.predictor import Nominal

Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class Diagnosis:
    """A verdict with everything that it rests on.

    `document` is the report as JSON; `predictor` the corrected model, `patch` the same as changes
    to a robot's MJCF.
    """

    document: Mapping[str, Json]
    predictor: Corrected
    patch: Patch
    recordings: Recordings
    gap: Gap
    choice: Choice
    experiment: Experiment | None
    search: Search
    nominal: RolloutFit

    @property
    def plant(self) -> Plant:
        """The plant that was diagnosed."""
        return self.recordings.plant

    @property
    def validation(self) -> Sequence[Episode]:
        """The episodes that were compared on, without what says nothing."""
        return self.recordings.validation

    def artifact(self, episodes: Sequence[Episode]) -> Artifact:
        """The corrected model as an artifact, with the recordings and the verdict that it comes
        from."""
        return pack(
            self.predictor,
            {
                "origin": "diagnosis",
                "episodes": [e.digest for e in episodes],
                "verdict": str(self.document["verdict"]),
            },
        )


class _Selection:
    """Chooses among the candidates of a search, by the recordings' selection criteria."""

    def __init__(self, recordings: Recordings, search: Search) -> None:
        self.search, self.criteria = search, recordings.criteria
        self.nominal = search.problem.fits.nominal(recordings.plant.parameters)

    def choice(self) -> Choice:
        """The choice among all candidates, made again once aliases of the answer were tried, and
        once the fits of the answer and of its rivals stand at their minima."""
        choice = self._select()
        for _ in range(SEARCH.alias_rounds):
            self.search.try_aliases(choice.winner)
            choice = self._select()
        if self.search.problem.strategy.robot:
            return self._with_rivals_converged(choice)
        return self._converged(choice)

    def _select(self) -> Choice:
        level = partial(noise_level, self.search.problem.fits)
        return select(list(self.search), self.nominal, self.criteria, level)

    def _with_rivals_converged(self, choice: Choice) -> Choice:
        """The choice with its alternatives' fits at their minima; a robot's answer is refitted on
        finer steps anyway."""
        fits = self.search.problem.fits
        rivals = tuple(self.search.adopt(fits.converged(c.fit)) for c in choice.rivals)
        return replace(choice, rivals=rivals)

    def _converged(self, choice: Choice) -> Choice:
        """The choice once the fits of all that it names stand at their minima: a better fit of one
        may unseat another."""
        search, done = self.search, set[Hypothesis]()
        for _ in range(SEARCH.refits):
            named = {c.hypothesis: c for c in (search.base, choice.winner, *choice.rivals)}
            wanted = [c for hypothesis, c in named.items() if hypothesis not in done]
            if not wanted:
                break
            for converged in in_parallel(lambda c: search.problem.fits.converged(c.fit), wanted):
                done.add(converged.hypothesis)
                search.adopt(converged)
            choice = self._select()
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

    Episodes that do not declare their stage are judged as a simulator's, whose laws are exact, and
    where no composition explains them so, as a machine's. Of a machine with one joint the few
    stretches that every effect misses by far are put aside, and the search is made without them.
    """
    progress("looking for faults in the log", 0.0)
    recordings = Recordings.of(plant, episodes)
    diagnosis = _diagnosis(recordings, episodes, seed, progress, solve)
    if diagnosis.choice.verdict is not Conclusion.UNKNOWN or recordings.declares_stage:
        return diagnosis
    progress("once more, as a machine's", 0.0)
    return _diagnosis(recordings.as_of_a_machine(), episodes, seed, progress, solve)


def _diagnosis(
    recordings: Recordings,
    episodes: Sequence[Episode],
    seed: int,
    progress: Progress,
    solve: Solve,
) -> Diagnosis:
    plant = recordings.plant
    progress("looking at the episodes", 0.0)
    explored = explore(recordings, assess(plant, recordings.adaptation), progress, solve)
    search, recordings = explored.search, explored.searched.recordings
    quality, adaptation = explored.searched.quality, recordings.adaptation
    validation = recordings.validation
    selection = _Selection(recordings, search)
    predictors = Predictors(recordings, quality, search)
    choice = best_of_the_alike(selection.choice(), predictors)
    choice = without_idle(choice, predictors)
    choice = second_look(choice, predictors)
    choice = certain_of_the_rest(choice, predictors)
    nominal, problem = selection.nominal, search.problem
    progress("measuring on held-out episodes", 0.0)
    refit = final_refit(recordings, problem, choice.winner)
    predictor = predictors.corrected(refit.answer.fit, refit.scheme)
    if predictors.is_spoilt(predictor, choice.winner):
        refit = FinalRefit.none(problem, choice.winner)
        predictor = predictors.corrected(refit.answer.fit, refit.scheme)
    refitted = predictors.corrected(search.base.fit)
    same = predictors.predictor(nominal, refit.scheme) or Nominal(plant)
    noise = Noise(quality.noise, quality.correlation)
    measured = partial(measure, Nominal(plant), same, refitted)
    gap = measured(predictor, validation, noise, seed)
    choice, served = agreeing(choice, gap), Served.CORRECTED
    if predicts_worse(gap):
        least = min(gap.before, gap.same_numbers, gap.parameters_only)
        choice, better = fallback(choice, predictors, least)
        refit = FinalRefit.none(problem, choice.winner)
        nearest = predictors.predictor(choice.winner.fit) if better else None
        served = Served.CORRECTED if nearest is not None else Served.NOMINAL
        predictor = nearest or nominal_predictor(plant, same, predictors)
        gap = measured(predictor, validation, noise, seed)
    progress("whether recordings agree", 0.0)
    agreed = Agreement()
    if served is Served.CORRECTED:
        agreed = agreement(adaptation, refit.fits, refit.answer.fit)
    progress("what the data speak against", 0.0)
    excluded, unexcited = bounds(search, choice, plant, recordings.criteria.alike)
    experiment = next_experiment(plant, quality, search, choice, Recorded.of(plant, adaptation))
    changes = patch(predictor)
    minima = Minima(refit.answer.minima, refit.other, agreed.wider)
    share = shares(search, choice, nominal)
    document = report(
        plant=plant,
        quality=quality,
        search=search,
        choice=choice,
        answer=refit.answer,
        nominal=nominal,
        gap=gap,
        effects=estimates(minima, problem.fitter, plant, share),
        alternatives=[alternative(plant, search, rival) for rival in choice.rivals],
        patch=changes,
        parameters=parameter_table(plant, problem.fitter.directions, minima)
        if served is Served.CORRECTED
        else {},
        between=agreed.document(plant, minima),
        excluded=excluded,
        unexcited=unexcited,
        shown=identifiability(recordings, problem),
        carried=payload(plant, problem.fitter.directions, refit.answer, adaptation)
        if served is Served.CORRECTED
        else None,
        where=locate(plant, search, choice.winner, nominal, adaptation, validation),
        experiment=experiment,
        drives=recordings.drives,
        put_aside=recordings.put_aside,
        judged_as=recordings.judged_as,
        episodes=episodes,
        findings=recordings.findings,
        ramps_leave=explored.ramps_leave,
        served=served,
        seed=seed,
    )
    progress("done", 1.0)
    return Diagnosis(
        document, predictor, changes, recordings, gap, choice, experiment, search, nominal
    )
