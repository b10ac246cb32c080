"""The fit as a state and a step: when it gains, damps, takes derivatives anew, and ends."""

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest

from trueup.fit.levenberg_marquardt import (
    DAMPING,
    GROW,
    GROW_FAST,
    MOST_DAMPING,
    SHRINK_FAST,
    End,
    Objective,
    State,
    begin,
    minimise,
    step,
)


@dataclass
class Equations:
    """Those of a cost of one number, whose linear model leads `by` and expects `expected`."""

    cost: float
    by: float
    expected: float

    def step(self, damping, *_):
        return np.array([self.by / (1.0 + damping)]), {}, self.expected


class Rollouts:
    """A cost of one number; what its linear model expects is `promise` times the truth."""

    def __init__(self, cost, slope, promise=1.0):
        self.cost, self.slope, self.promise, self.asked = cost, slope, promise, []

    def evaluate(self, _task, values, _starts, old=None):
        x = float(values[0])
        self.asked.append((x, old is not None))
        by = self.slope(x)
        expected = self.promise * max(self.cost(x) - self.cost(x + by), 1e-9)
        return Equations(self.cost(x), by, expected), ({} if old is None else old)


def objective(rollouts, *, keeps=0):
    free = SimpleNamespace(
        low=np.array([-np.inf]),
        high=np.array([np.inf]),
        at=lambda values: values.copy(),
        moved=lambda values, by: values + by,
    )
    task = SimpleNamespace(free=free, keeps=keeps, moved=lambda starts, _: starts)
    return Objective(rollouts, task, 100, np.zeros(1), np.zeros(1))


def parabola(promise=1.0):
    return Rollouts(lambda x: 1e4 * (x - 3.0) ** 2 + 50.0, lambda x: 3.0 - x, promise)


def test_a_parabola_is_minimised_in_a_few_steps():
    problem = objective(parabola())
    last = minimise(problem, begin(problem, np.zeros(1), {}), 12, 1e-4)
    assert last.values == pytest.approx(3.0, abs=1e-3)
    assert last.end is End.CONVERGED


def test_a_step_changes_nothing_of_the_state_that_it_is_taken_from():
    problem = objective(parabola())
    first = begin(problem, np.zeros(1), {})
    again = [step(problem, first, 1e-4) for _ in range(2)]
    assert first.values == 0.0
    assert again[0] == again[1]


def test_a_step_that_keeps_its_promise_is_damped_less_next_time():
    problem = objective(parabola())
    after = step(problem, begin(problem, np.zeros(1), {}), 1e-4)
    assert after.damping == pytest.approx(DAMPING * SHRINK_FAST)
    assert not after.astray


def test_a_step_that_gains_nothing_stays_where_it_was_and_is_damped_more():
    problem = objective(Rollouts(lambda x: 50.0 + 100.0 * abs(x), lambda _: 1.0, 1e12))
    first = begin(problem, np.zeros(1), {})
    after = step(problem, first, 1e-4)
    assert (after.values, after.damping) == (first.values, DAMPING * GROW)


def test_a_step_that_leads_astray_does_not_count():
    """Each of them is damped a thousandfold, until one does not lead astray any more."""
    problem = objective(Rollouts(lambda x: 1.0 + 1e6 * x * x, lambda _: 1e3, 1e30))
    after = step(problem, begin(problem, np.zeros(1), {}), 1e-4)
    assert (after.astray, after.damping) == (True, DAMPING * GROW_FAST)
    assert minimise(problem, after, 1, 1e-4).damping > MOST_DAMPING / GROW_FAST


def test_a_fit_that_runs_away_where_it_begins_takes_no_step():
    problem = objective(Rollouts(lambda _: np.inf, lambda _: 1.0))
    first = begin(problem, np.zeros(1), {})
    assert minimise(problem, first, 12, 1e-4) == first


def test_derivatives_are_kept_while_steps_keep_their_promise():
    rollouts = parabola()
    problem = objective(rollouts, keeps=1)
    after = step(problem, begin(problem, np.zeros(1), {}), 1e-4)
    assert after.stale
    assert [old for _, old in rollouts.asked] == [False, True]


def test_derivatives_are_taken_anew_where_a_step_gained_less_than_half():
    rollouts = parabola(promise=3.0)
    problem = objective(rollouts, keeps=1)
    after = step(problem, begin(problem, np.zeros(1), {}), 1e-4)
    assert not after.stale
    assert [old for _, old in rollouts.asked] == [False, True, False]


@pytest.mark.parametrize(("tolerance", "anew"), [(1e-4, True), (1e-2, False)])
def test_a_fit_ends_on_old_derivatives_only_where_it_may_be_rough(tolerance, anew):
    rollouts = parabola()
    problem = objective(rollouts, keeps=1)
    at = Equations(50.0, 0.0, 0.0)
    state = State(np.array([3.0]), {}, at, {}, stale=True)
    after = step(problem, state, tolerance)
    assert (after.end is None, after.stale, bool(rollouts.asked)) == (anew, not anew, anew)
