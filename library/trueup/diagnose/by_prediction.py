"""By prediction: candidates judged as the report judges them, by the error of predictions of
held-out episodes that start from a filter.

A search fits with free starts of windows, which may hide in them what a prediction has to foresee.
So of compositions that the evidence does not tell apart the one that predicts best is the answer,
and what predicts worse than the nominal model or its refitted form is no answer.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy import stats

from trueup.cores import in_parallel
from trueup.diagnose.candidate import Candidate
from trueup.diagnose.data_quality import DataQuality
from trueup.diagnose.filtering import Prior, corrected, prior_of
from trueup.diagnose.intervals import half_widths
from trueup.diagnose.measure import (
    Gap,
    held_out_error,
    knows_beginnings,
    squared_errors,
    windows_of,
)
from trueup.diagnose.model_selection import Choice, Conclusion, numbers_of
from trueup.diagnose.problem_setup import Recordings
from trueup.diagnose.search import Search
from trueup.diagnose.tuning import SELECTION
from trueup.episode.episode import Episode
from trueup.fit.rollout_fit import RolloutFit
from trueup.model.block import kind
from trueup.model.corrected import Corrected
from trueup.model.hypothesis import Hypothesis
from trueup.model.plant import Plant
from trueup.model.predictor import Nominal, Predictor
from trueup.model.series import Scheme


@dataclass(frozen=True)
class Predictors:
    """The predictors of a search's candidates, and their errors on held-out episodes. A predictor
    is `made` once, for its filter takes many rollouts."""

    recordings: Recordings
    quality: DataQuality
    search: Search
    made: dict[tuple[Hypothesis, bytes, Scheme], Corrected] = field(default_factory=dict)

    def corrected(self, fit: RolloutFit, scheme: Scheme | None = None) -> Corrected:
        """The predictor of a fit, under the search's scheme of integration or another. Raises
        LinAlgError where its numbers are so far off that it has no filter."""
        recordings, scheme = self.recordings, scheme or self.search.problem.scheme
        key = fit.hypothesis, fit.values.tobytes(), scheme
        if key not in self.made:
            self.made[key] = corrected(
                recordings.plant,
                self.quality,
                fit,
                scheme,
                recordings.adaptation,
                self.prior,
            )
        return self.made[key]

    @cached_property
    def prior(self) -> Prior | None:
        """The prior of velocities, which all predictors share."""
        return prior_of(self.recordings.plant, self.quality, self.recordings.adaptation)

    def predictor(self, fit: RolloutFit, scheme: Scheme | None = None) -> Corrected | None:
        """The predictor of a fit, None where it has no filter."""
        try:
            return self.corrected(fit, scheme)
        except np.linalg.LinAlgError:
            return None

    def error(self, candidate: Candidate) -> float:
        """Root mean square error of the candidate's predictions of held-out episodes."""
        predictor = self.predictor(candidate.fit)
        return self.error_of(predictor) if predictor is not None else float("inf")

    def error_of(self, predictor: Predictor) -> float:
        """Root mean square error of a predictor's predictions of held-out episodes."""
        return held_out_error(predictor, self.recordings.validation)

    def is_spoilt(self, refitted: Predictor, candidate: Candidate) -> bool:
        """Whether a refit of a candidate predicts much worse than the candidate itself, or worse
        than the nominal model or its refitted form, and the candidate does not."""
        before, after = self.error(candidate), self.error_of(refitted)
        limit = SELECTION.no_better * min(self.nominal_error, self.error(self.search.base))
        return before < SELECTION.much_better * after or before <= limit < after

    @cached_property
    def nominal_error(self) -> float:
        """The error of the nominal model."""
        return self.error_of(Nominal(self.recordings.plant))

    def errors(self, candidates: Sequence[Candidate]) -> list[float]:
        """The errors of candidates."""
        return list(in_parallel(self.error, candidates))

    def misses(
        self, part: Candidate, whole: Candidate, episodes: Sequence[Episode] | None = None
    ) -> bool:
        """Whether windows of some episodes, or of all, are predicted better by the whole than by a
        part of it, by Wilcoxon's signed-rank test of the logarithms of their errors.

        So every window counts: mean squares are those of the few in which a motion is about to tip
        over. Where there are too few windows for the test, the whole is taken to be better.
        """
        less, more = self.predictor(part.fit), self.predictor(whole.fit)
        if less is None or more is None:
            return True
        plant, known = self.recordings.plant, knows_beginnings(less) and knows_beginnings(more)
        recorded = episodes or self.recordings.every
        windows = windows_of(plant, recorded, plant.horizon_s, beginnings=known)
        with np.errstate(divide="ignore", invalid="ignore"):
            errors = [np.log(squared_errors(p, windows, self.quality.motion)) for p in (less, more)]
            gained = errors[0] - errors[1]
        gained = gained[np.isfinite(gained)]
        if 0.5 ** len(gained) > SELECTION.chance:
            return True
        return bool(stats.wilcoxon(gained, alternative="greater").pvalue < SELECTION.chance)


def nominal_predictor(plant: Plant, same_numbers: Predictor, predictors: Predictors) -> Corrected:
    """The nominal numbers as a corrected model: started from a filter, or from what was observed
    last, whichever predicts better."""
    observed = np.zeros((len(plant.joints), 4, 2))  # of position, velocity, disturbance, lag
    observed[:, 0, 0] = observed[:, 1, 1] = 1.0
    from_observed = replace(
        Corrected.of_numbers(plant, plant.parameters), gain=(tuple(observed.ravel().tolist()),)
    )
    if not isinstance(same_numbers, Corrected):
        return from_observed
    return min((same_numbers, from_observed), key=predictors.error_of)


def best_of_the_alike(choice: Choice, predictors: Predictors) -> Choice:
    """The choice, its answer exchanged for that alternative which predicts much better; on a
    machine also for one that predicts about as well with fewer numbers.

    What a simulator's log does not tell apart has its price for each number already.
    """
    alike = [choice.winner, *choice.rivals[: SELECTION.most_measured]]
    if len(alike) == 1:
        return choice
    errors = np.array(predictors.errors(alike))
    best = int(np.argmin(errors))
    if not errors[best] < SELECTION.much_better * errors[0]:
        best = 0
    if predictors.recordings.criteria.of_machine:
        near = np.flatnonzero(SELECTION.much_better * errors <= errors.min())
        best = int(min(near, key=lambda i: (numbers_of(alike[i]), i != best)))
    others = (choice.winner, *(r for r in choice.rivals if r is not alike[best]))
    return replace(choice, winner=alike[best], rivals=others if best else choice.rivals)


def without_idle(choice: Choice, predictors: Predictors) -> Choice:
    """The choice without effects of a machine that fit what is peculiar to some recordings: those
    denied by their own intervals without which predictions are about as good, and those that the
    predictions of most windows do not miss."""
    winner = choice.winner
    if choice.verdict is not Conclusion.EFFECT or not predictors.recordings.criteria.of_machine:
        return choice
    for denied in _denied(winner):
        smaller = _without(winner, {denied}, predictors)
        if smaller is None:
            continue
        errors = predictors.errors([winner, smaller])
        if SELECTION.much_better * errors[1] <= errors[0]:
            return without_idle(_smaller(choice, smaller, predictors), predictors)
    for name in dict.fromkeys(kind(t).name for t in winner.hypothesis.effects):
        alike = {t for t in winner.hypothesis.effects if kind(t).name == name}
        smaller = _without(winner, alike, predictors)
        if smaller is not None and not predictors.misses(smaller, winner):
            return without_idle(_smaller(choice, smaller, predictors), predictors)
    return choice


def _without(winner: Candidate, terms: set[str], predictors: Predictors) -> Candidate | None:
    """A composition without some of its terms, None where nothing is left of it."""
    rest = winner.hypothesis
    for t in terms:
        rest = rest.without(t)
    return predictors.search.fitted(rest, winner) if rest.effects else None


def _smaller(choice: Choice, winner: Candidate, predictors: Predictors) -> Choice:
    """The choice with a part of its answer as the answer, which is partial where it leaves more
    than an answer may."""
    rivals = tuple(r for r in choice.rivals if r.hypothesis != winner.hypothesis)
    left = max(choice.left, left_of(winner, predictors.search.base))
    partial = choice.partial or left > predictors.recordings.criteria.unexplained
    return replace(choice, winner=winner, rivals=rivals, left=left, partial=partial)


def left_of(candidate: Candidate, base: Candidate) -> float:
    """The part of the refitted gap that a candidate leaves on validation episodes."""
    leaves, gap = candidate.reduced_chi_square - 1.0, base.reduced_chi_square - 1.0
    return max(leaves, 0.0) / max(gap, 1e-12)


def _denied(candidate: Candidate) -> list[str]:
    """The effects of a candidate whose first number may be that of none, by its interval."""
    fit = candidate.fit
    values = dict(zip(fit.free.names, fit.free.at(fit.values), strict=True))
    widths = half_widths(fit, fit)
    denied = []
    for t in candidate.hypothesis.effects:
        number = kind(t).params[0]
        value, width = values.get((t, number.name)), widths.get((t, number.name))
        if value is not None and width is not None and abs(value - number.null) <= width:
            denied.append(t)
    return denied


def predicts_worse(gap: Gap) -> bool:
    """Whether the answer predicts worse than the nominal model, or than its refitted form."""
    return gap.after > SELECTION.no_better * min(gap.before, gap.same_numbers, gap.parameters_only)


def fallback(choice: Choice, predictors: Predictors, least: float) -> tuple[Choice, bool]:
    """The candidate that predicts best where the answer predicts worse than the nominal model or
    its refitted form, whose smaller error is `least`; and whether it predicts better than that.

    It is no answer: it is the nearest to one.
    """
    search = predictors.search
    sound = sorted((c for c in search if np.isfinite(c.total)), key=lambda c: c.total)
    some = [c for c in sound if c.hypothesis != choice.winner.hypothesis]
    nearest = [*some[: SELECTION.most_measured], search.base]
    errors = predictors.errors(nearest)
    best = int(np.argmin(errors))
    chosen = nearest[best]
    left = left_of(chosen, search.base)
    return (
        replace(choice, verdict=Conclusion.UNKNOWN, winner=chosen, rivals=(), left=left),
        errors[best] < SELECTION.no_better * least,
    )
