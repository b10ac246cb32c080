"""Second look: where no composition explains a machine's recordings, whether an effect certainly
acts all the same, by predictions, recording by recording.

Fits on windows with starts of their own weigh what a prediction does not show, and recordings that
are held out may be few and all of one kind. So the refitted nominal form and the best compositions
are compared by predictions of every recording, those that were fitted left out one by one, as in
leave-one-out cross-validation; of a robot by those of held-out windows. Source: M. Stone, Journal
of the Royal Statistical Society B 36 (1974).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trueup.cores import in_parallel
from trueup.diagnose.by_prediction import Predictors
from trueup.diagnose.candidate import Candidate
from trueup.diagnose.measure import motion_of, squared_errors, windows_of
from trueup.diagnose.model_selection import Choice, Conclusion, numbers_of
from trueup.diagnose.search import Search
from trueup.diagnose.tuning import SELECTION
from trueup.diagnose.tuning_of_answers import SECOND_LOOK
from trueup.episode.episode import Episode
from trueup.model.block import kind
from trueup.model.predictor import Predictor

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Predicted:
    """A candidate, and the mean square error of its predictions of each recording, `(recordings,)`:
    of one that was fitted, by a fit without it."""

    candidate: Candidate
    errors: Array

    @property
    def total(self) -> float:
        """Mean over recordings."""
        return float(self.errors.mean())


def second_look(choice: Choice, predictors: Predictors) -> Choice:
    """The choice, or that of a part that certainly acts: an effect without which predictions miss
    at least twice as much, on nearly every recording, and with which none that were held out are
    worse.

    Only where no composition was the answer, on a machine, and of one joint with some recordings to
    leave out.
    """
    recordings, search = predictors.recordings, predictors.search
    strategy = recordings.strategy
    if choice.verdict is not Conclusion.UNKNOWN or not strategy.physical:
        return choice
    if strategy.robot:
        return _of_robot(choice, predictors)
    if len({e.recording for e in recordings.adaptation}) < SECOND_LOOK.fewest:
        return choice
    limit = SELECTION.no_better * min(predictors.nominal_error, predictors.error(search.base))
    singles = _likely_alone(search)
    errors = predictors.errors(singles)
    fair = [c for c, error in zip(singles, errors, strict=True) if error <= limit]
    if not fair:
        return choice
    base, *ranked = predictions([search.base, *fair], predictors)
    best = min(ranked, key=lambda p: p.total)
    left = best.total / max(base.total, 1e-300)
    if not _certainly_acts(best, base):
        return choice
    alike = (1.0 + recordings.criteria.alike) * best.total
    rivals = tuple(p.candidate for p in ranked if p is not best and p.total < alike)
    partial = left > recordings.criteria.unexplained
    return Choice(Conclusion.EFFECT, best.candidate, rivals, left, partial=partial)


def certain_of_the_rest(choice: Choice, predictors: Predictors) -> Choice:
    """The choice; where stretches were put aside, only one that certainly acts by predictions of
    every recording, for what is left of them was not chosen blindly. Of compositions that predict
    alike the one with the fewest numbers is the answer, and the others are alternatives.
    """
    search, recordings = predictors.search, predictors.recordings
    if not recordings.put_aside or choice.verdict is not Conclusion.EFFECT:
        return choice
    named = [choice.winner, *choice.rivals[: SELECTION.most_measured]]
    others = [c for c in _likely_alone(search) if c not in named]
    base, *ranked = predictions([search.base, *named, *others], predictors)
    best = min(ranked, key=lambda p: p.total)
    if not _certainly_acts(best, base):
        return replace(choice, verdict=Conclusion.UNKNOWN, rivals=(), partial=False)
    limit = (1.0 + recordings.criteria.alike) * best.total
    alike = [p.candidate for p in ranked if p.total <= limit]
    answer = min(alike, key=lambda c: (numbers_of(c), c is not choice.winner))
    return replace(choice, winner=answer, rivals=tuple(c for c in alike if c is not answer))


def _likely_alone(search: Search) -> list[Candidate]:
    """The compositions of one effect that fit best."""
    singles = [c for c in search if len(c.hypothesis.effects) == 1 and np.isfinite(c.total)]
    return sorted(singles, key=lambda c: c.fit.cost)[: SECOND_LOOK.compositions]


def _certainly_acts(part: Predicted, base: Predicted) -> bool:
    """Whether predictions without a part miss at least twice as much, on nearly every recording."""
    helps = float(np.mean(part.errors < base.errors))
    return part.total <= SECOND_LOOK.leaves * base.total and helps >= SECOND_LOOK.on_most


def _of_robot(choice: Choice, predictors: Predictors) -> Choice:
    """The choice, or that of one kind of effect, at whichever joints of a robot: of those with
    which held-out windows are certainly predicted better than by refitted parameters alone, the
    one that fits best; the others are alternatives where windows do not tell them from it.

    A robot's fits take long, so that none is made again; and its motions may be about to tip over,
    so that windows are compared by the logarithms of their errors.
    """
    search, recordings = predictors.search, predictors.recordings
    held_out, least = recordings.validation, predictors.error(search.base)
    limit = SELECTION.no_better * min(predictors.nominal_error, least)
    alone = [c for c in search if len({kind(t) for t in c.hypothesis.effects}) == 1]
    alone = sorted(alone, key=lambda c: c.total)[: SECOND_LOOK.compositions]
    fair = [
        c
        for c, error in zip(alone, predictors.errors(alone), strict=True)
        if error <= limit and predictors.misses(search.base, c, held_out)
    ]
    if not fair or not np.isfinite(least):
        return choice
    best, *others = fair
    left = (predictors.error(best) / max(least, 1e-300)) ** 2
    if left > SECOND_LOOK.leaves:
        return choice
    rivals = tuple(c for c in others if not predictors.misses(c, best))
    partial = left > recordings.criteria.unexplained
    return Choice(Conclusion.EFFECT, best, rivals, left, partial=partial)


def predictions(candidates: Sequence[Candidate], predictors: Predictors) -> list[Predicted]:
    """What candidates predict of every recording."""
    return list(in_parallel(lambda c: _predicted(c, predictors), candidates))


def _predicted(candidate: Candidate, predictors: Predictors) -> Predicted:
    recordings = predictors.recordings
    by_recording: dict[str, list[Episode]] = {}
    for e in recordings.every:
        by_recording.setdefault(e.recording, []).append(e)
    fitted = {e.recording for e in recordings.adaptation}
    whole = predictors.predictor(candidate.fit)
    errors = []
    for recording, episodes in by_recording.items():
        predictor = _without(candidate, recording, predictors) if recording in fitted else whole
        errors.append(_error(predictor, episodes, recordings.every))
    return Predicted(candidate, np.array(errors))


def _without(candidate: Candidate, recording: str, predictors: Predictors) -> Predictor | None:
    """The candidate's predictor, fitted without one recording."""
    problem = predictors.search.problem
    parts = {e.digest for e in predictors.recordings.adaptation if e.recording == recording}
    data = [s for s in problem.adaptation if s.digest not in parts]
    at = candidate.fit
    fit = problem.fitter.fit(
        data,
        at.hypothesis,
        at.values,
        problem.fits.estimated_starts(data, at),
        iterations=SECOND_LOOK.iterations,
        fixed=problem.fits.resting(at.values, at.hypothesis.effects),
    )
    return predictors.predictor(fit) if np.isfinite(fit.cost) else None


def _error(
    predictor: Predictor | None, episodes: Sequence[Episode], every: Sequence[Episode]
) -> float:
    """Mean square error of the predictions of some episodes, in units of the motion of all."""
    if predictor is None:
        return float("inf")
    plant = predictor.plant
    windows = windows_of(plant, episodes, plant.horizon_s, beginnings=False)
    return float(squared_errors(predictor, windows, motion_of(plant, every)).mean())
