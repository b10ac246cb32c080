"""Linear least squares: the answer, its intervals, and what a poor design says of itself."""

import numpy as np
import pytest

from trueup.fit.least_squares import ridge, solve


def test_values_are_those_that_made_the_targets_whatever_the_units_of_the_columns():
    design = np.random.default_rng(0).normal(size=(50, 3)) * [1.0, 1e6, 1e-6]
    fit = solve(design, design @ [2.0, -3e-6, 5e6])
    assert fit.values == pytest.approx([2.0, -3e-6, 5e6])
    assert (fit.rank, fit.residual_rms) == (3, pytest.approx(0.0, abs=1e-9))
    assert fit.condition < 3.0


@pytest.mark.parametrize("rows", [4, 6, 60])
def test_intervals_hold_the_true_value_as_often_as_they_say_however_few_the_rows(rows):
    """Of four rows and two columns the normal distribution's would hold it four times of five."""
    rng, held = np.random.default_rng(rows), []
    for _ in range(1000):
        design = rng.normal(size=(rows, 2))
        fit = solve(design, design @ [1.0, -1.0] + rng.normal(size=rows))
        held.append(np.abs(fit.values - [1.0, -1.0]) <= fit.half_widths)
    assert 0.93 <= np.mean(held) <= 0.97


def test_rows_that_share_their_noise_widen_the_intervals():
    rng = np.random.default_rng(3)
    design = rng.normal(size=(200, 2))
    target = design @ [1.0, 2.0] + rng.normal(size=200)
    alone, shared = solve(design, target), solve(design, target, correlated_rows=4)
    assert shared.half_widths == pytest.approx(2.0 * alone.half_widths, rel=0.05)


def test_a_column_that_repeats_another_shows_in_rank_and_condition():
    column = np.arange(1.0, 9.0)[:, None]
    fit = solve(np.hstack([column, 2.0 * column]), column[:, 0])
    assert fit.rank == 1
    assert fit.condition > 1e12


def test_a_column_of_zeros_gets_the_value_zero():
    fit = solve(np.column_stack([np.arange(5.0), np.zeros(5)]), 3.0 * np.arange(5.0))
    assert fit.values == pytest.approx([3.0, 0.0])


def test_a_penalty_shrinks_weights_towards_zero():
    design = np.eye(3)
    targets = np.array([[2.0], [4.0], [6.0]])
    assert ridge(design, targets, 1.0) == pytest.approx(targets / 2.0)
    assert ridge(design, targets, 0.0) == pytest.approx(targets)
