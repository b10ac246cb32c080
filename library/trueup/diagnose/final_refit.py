"""Final refit: the answer fitted once more on every sample and on finer steps, so that integration
leaves no mark on its estimates."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trueup.diagnose.candidate import Candidate
from trueup.diagnose.problem_setup import Recordings, in_pieces
from trueup.diagnose.search_problem import SearchProblem
from trueup.diagnose.tuning import SEARCH
from trueup.diagnose.windowed_fits import WindowedFits, observed_starts
from trueup.fit.rollout_fit import RolloutFit
from trueup.model.series import Scheme, on_finer_steps
from trueup.model.stack import Stack


@dataclass(frozen=True)
class FinalRefit:
    """The answer as it was fitted last, to the windows of `fits`, and the `other` fit of the same
    composition, on other steps."""

    answer: Candidate
    fits: WindowedFits
    other: RolloutFit

    @staticmethod
    def none(problem: SearchProblem, best: Candidate) -> FinalRefit:
        """A search's best composition as it is."""
        return FinalRefit(best, problem.fits, best.fit)

    @property
    def scheme(self) -> Scheme:
        """How the answer is integrated."""
        return self.fits.scheme


def final_refit(recordings: Recordings, problem: SearchProblem, best: Candidate) -> FinalRefit:
    """The final refit of a search's best composition.

    Where its cost on whole windows is so rough that no minimum can be proven, on shorter ones, in
    which errors grow less. A machine's windows are those of its predictions: there the search's own
    fit does, where it is proven, or where it predicts better.
    """
    scheme, strategy = problem.scheme, problem.strategy
    if scheme.alpha == 0.0 and not strategy.physical:
        return FinalRefit.none(problem, best)
    finer = scheme
    if scheme.alpha and strategy.thorough:
        finer = on_finer_steps(recordings.plant, scheme, SEARCH.finer_steps)
    shortens = not strategy.robot and not strategy.physical
    refits: list[tuple[Candidate, WindowedFits]] = []
    for part in SEARCH.shortened if shortens else SEARCH.shortened[:1]:
        last = _last_windows(recordings, problem, finer, problem.fits.length_s * part)
        refit = _refit(last, problem, best)
        # from where the log says, or from where fits best
        before = last.candidate(best.fit) if strategy.physical else best
        limit = SEARCH.went_astray * before.reduced_chi_square
        if refit is not None and refit.reduced_chi_square < limit:
            refits.append((refit, last))
        if refits and refits[-1][0].fit.proven:
            break
    as_it_is = best, problem.fits
    proven = [(c, fits) for c, fits in (*refits, as_it_is) if c.fit.proven]
    fair = [
        (c, fits)
        for c, fits in refits
        if not strategy.physical or c.reduced_chi_square < before.reduced_chi_square
    ]
    answer, fits = [*proven, *fair, as_it_is][0]
    other = refits[0][0].fit if refits and answer is best else best.fit
    return FinalRefit(answer, fits, other)


def _last_windows(
    recordings: Recordings, problem: SearchProblem, scheme: Scheme, length_s: float
) -> WindowedFits:
    """Every sample in windows of a length [s] under a scheme.

    On a machine the windows start where the log says: what no law explains must not hide in their
    starts.
    """
    plant, strategy = recordings.plant, problem.strategy
    in_parts = strategy.in_pieces and strategy.thorough
    return WindowedFits(
        problem.fitter.holding() if strategy.physical else problem.fitter,
        strategy,
        Stack.cut(plant, recordings.adaptation, scheme, length_s),
        Stack.cut(plant, recordings.validation, scheme, length_s),
        length_s,
        in_pieces(plant, recordings.every, scheme, length_s) if in_parts else {},
    )


def _refit(last: WindowedFits, problem: SearchProblem, best: Candidate) -> Candidate | None:
    """The answer of a problem taken to its minimum on the last windows; None where it runs away
    there."""
    if last.pieces:
        starts = last.estimated_starts(last.adaptation, best.fit)
    else:
        starts = observed_starts(last.adaptation, best.fit)
    fit = last.fitter.fit(
        last.adaptation,
        best.hypothesis,
        best.fit.values,
        starts,
        iterations=SEARCH.converge_iterations,
        tolerance=SEARCH.final_tolerance if problem.strategy.thorough else SEARCH.rough_tolerance,
        fixed=problem.fits.resting(best.fit.values, best.hypothesis.effects),
    )
    if not np.isfinite(fit.cost):
        return None
    return last.converged(fit if last.fitter.held else last.pruned(fit))
