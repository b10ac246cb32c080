"""By prediction: the choice held to the yardstick that the report shows, the error of predictions
of held-out episodes that start from a filter.

A search fits with free starts of windows, which may hide in them what a prediction has to foresee.
So of compositions that the evidence does not tell apart the one that predicts best is the answer,
and what predicts worse than the nominal model or its refitted form is no answer.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from trueup.cores import in_parallel
from trueup.diagnose.candidate import Candidate
from trueup.diagnose.data_quality import DataQuality
from trueup.diagnose.filtering import corrected
from trueup.diagnose.intervals import half_widths
from trueup.diagnose.measure import Gap, held_out_error
from trueup.diagnose.model_selection import Choice, Conclusion, numbers_of
from trueup.diagnose.problem_setup import Recordings
from trueup.diagnose.search import Search
from trueup.diagnose.tuning import SELECTION
from trueup.fit.rollout_fit import RolloutFit
from trueup.model.block import kind
from trueup.model.corrected import Corrected
from trueup.model.plant import Plant
from trueup.model.predictor import Predictor
from trueup.model.series import Scheme


@dataclass(frozen=True)
class Yardstick:
    """What turns candidates of a search into predictors, and measures them."""

    recordings: Recordings
    quality: DataQuality
    search: Search

    def predictor(self, fit: RolloutFit, scheme: Scheme | None = None) -> Corrected | None:
        """The predictor of a fit, under the search's scheme of integration or another; None where
        its numbers are so far off that it has no filter."""
        recordings = self.recordings
        try:
            return corrected(
                recordings.plant,
                self.quality,
                fit,
                scheme or self.search.problem.scheme,
                recordings.adaptation,
            )
        except np.linalg.LinAlgError:
            return None

    def error(self, candidate: Candidate) -> float:
        """Root mean square error of the candidate's predictions of held-out episodes."""
        predictor = self.predictor(candidate.fit)
        return self.of(predictor) if predictor is not None else float("inf")

    def of(self, predictor: Predictor) -> float:
        """Root mean square error of a predictor's predictions of held-out episodes."""
        return held_out_error(predictor, self.recordings.validation)

    def is_much_better(self, candidate: Candidate, predictor: Predictor) -> bool:
        """Whether a candidate predicts much better than a predictor."""
        return self.error(candidate) < SELECTION.much_better * self.of(predictor)

    def errors(self, candidates: Sequence[Candidate]) -> list[float]:
        """The errors of candidates."""
        return list(in_parallel(self.error, candidates))


def nominal_predictor(plant: Plant, same_numbers: Predictor, yardstick: Yardstick) -> Corrected:
    """The nominal numbers as a corrected model: started from a filter, or from what was observed
    last, whichever predicts better."""
    observed = np.zeros((len(plant.joints), 4, 2))  # of position, velocity, disturbance, lag
    observed[:, 0, 0] = observed[:, 1, 1] = 1.0
    from_observed = replace(
        Corrected.of_numbers(plant, plant.parameters), gain=(tuple(observed.ravel().tolist()),)
    )
    if not isinstance(same_numbers, Corrected):
        return from_observed
    return min((same_numbers, from_observed), key=yardstick.of)


def best_of_the_alike(choice: Choice, yardstick: Yardstick) -> Choice:
    """The choice, its answer exchanged for that alternative which predicts much better; on a
    machine also for one that predicts about as well with fewer numbers.

    What a simulator's log does not tell apart has its price for each number already.
    """
    alike = [choice.winner, *choice.rivals[: SELECTION.most_measured]]
    if len(alike) == 1:
        return choice
    errors = np.array(yardstick.errors(alike))
    best = int(np.argmin(errors))
    if not errors[best] < SELECTION.much_better * errors[0]:
        best = 0
    if yardstick.recordings.criteria.of_machine:
        near = np.flatnonzero(SELECTION.much_better * errors <= errors.min())
        best = int(min(near, key=lambda i: (numbers_of(alike[i]), i != best)))
    others = (choice.winner, *(r for r in choice.rivals if r is not alike[best]))
    return replace(choice, winner=alike[best], rivals=others if best else choice.rivals)


def without_idle(choice: Choice, yardstick: Yardstick) -> Choice:
    """The choice without effects of a machine whose own intervals deny them and without which
    predictions are about as good: such a part fits what is peculiar to some recordings."""
    search, winner = yardstick.search, choice.winner
    if choice.verdict is not Conclusion.EFFECT or not yardstick.recordings.criteria.of_machine:
        return choice
    for denied in _denied(winner):
        rest = winner.hypothesis.without(denied)
        if not rest.effects:
            continue
        smaller = search.fitted(rest, winner)
        errors = yardstick.errors([winner, smaller])
        if SELECTION.much_better * errors[1] <= errors[0]:
            rivals = tuple(r for r in choice.rivals if r.hypothesis != rest)
            return without_idle(replace(choice, winner=smaller, rivals=rivals), yardstick)
    return choice


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


def fallback(choice: Choice, yardstick: Yardstick, least: float) -> tuple[Choice, bool]:
    """The candidate that predicts best where the answer predicts worse than the nominal model or
    its refitted form, whose smaller error is `least`; and whether it predicts better than that.

    It is no answer: it is the nearest to one.
    """
    search = yardstick.search
    sound = sorted((c for c in search if np.isfinite(c.total)), key=lambda c: c.total)
    some = [c for c in sound if c.hypothesis != choice.winner.hypothesis]
    nearest = [*some[: SELECTION.most_measured], search.base]
    errors = yardstick.errors(nearest)
    best = int(np.argmin(errors))
    chosen, base = nearest[best], search.base
    left = max(chosen.reduced_chi_square - 1.0, 0.0) / max(base.reduced_chi_square - 1.0, 1e-12)
    return (
        replace(choice, verdict=Conclusion.UNKNOWN, winner=chosen, rivals=(), left=left),
        errors[best] < SELECTION.no_better * least,
    )
