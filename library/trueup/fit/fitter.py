"""Fitter: parameters of a nominal form and any effects by least squares of the simulation error on
windows of recorded episodes (multiple shooting)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from trueup.fit.errors import KeptDerivatives
from trueup.fit.free_numbers import Directions
from trueup.fit.levenberg_marquardt import End, Objective, begin, minimise
from trueup.fit.rollout_fit import RolloutFit, Start
from trueup.fit.rollouts import Rollouts
from trueup.model.dynamics import CompiledFamily
from trueup.model.effect import effects
from trueup.model.family import families
from trueup.model.hypothesis import Hypothesis, Scales
from trueup.model.series import DECLARED, Series, unobserved

Array = NDArray[np.float64]


class Fitter(Rollouts):
    """Fits hypotheses on one nominal form to a set of series."""

    def fit(
        self,
        data: Sequence[Series],
        hypothesis: Hypothesis,
        values: Array,
        starts: Mapping[str, Start] | None = None,
        *,
        iterations: int = 12,
        fixed: Iterable[tuple[str, str]] = (),
        tolerance: float = 1e-4,
        derivatives: KeptDerivatives | None = None,
    ) -> RolloutFit:
        """The fit from the block's vector `values`, with `fixed` numbers (term, name) at theirs.

        `derivatives` are some of a fit nearby, to begin with. A rollout that runs away where the
        fit begins makes an infinite cost.
        """
        task = self.task(data, hypothesis, self.free(hypothesis, fixed))
        objective = Objective.of(self, task)
        values = task.free.moved(values, np.zeros(len(task.free.rows)))
        first = begin(objective, values, self.initial_starts(starts, data, hypothesis), derivatives)
        last = minimise(objective, first, iterations, tolerance)
        n, equations = len(task.free.rows), last.equations
        costs = equations.sums[:, 0, 0].copy()
        information, scores = np.zeros((n, n)), np.zeros((len(costs), n))
        if np.isfinite(equations.cost):
            information, scores = equations.reduced_with_scores()
        return RolloutFit(
            hypothesis,
            last.values,
            task.free,
            last.starts,
            equations.cost,
            costs,
            objective.samples,
            information,
            last.end is End.CONVERGED,
            scores,
        )

    def derivatives_of(self, data: Sequence[Series], fit: RolloutFit) -> KeptDerivatives | None:
        """The derivatives of a fit that fits nearby may begin with; None where all of them take one
        block anyway."""
        task = self.task(data, fit.hypothesis, self.free(fit.hypothesis))
        return self.evaluate(task, fit.values, fit.starts)[1] if task.keeps else None


def warm(family: str = "oscillator") -> int:
    """Compile what fits and diagnoses need into the cache; the number of effects in the kernel."""
    dynamics = CompiledFamily(families()[family])
    one = unobserved(DECLARED, np.arange(4.0), np.zeros((4, 1)), np.ones(1), 1.0)
    names = Directions.of_family(dynamics.parameter_names)
    Fitter(dynamics.form, names, [Scales(1.0, 1.0, 1.0, 1.0)], np.ones(2)).fit(
        [one], Hypothesis(), dynamics.form.block.nulls, iterations=1
    )
    return len(effects())
