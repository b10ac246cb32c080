"""Normal equations from outer products of windows."""

import numpy as np

from trueup.fit.normal_equations import NormalEquations


def of_two_states(alike):
    """An episode of three windows: an error, a parameter, two hidden states, a start of two."""
    rows = np.random.default_rng(1).normal(size=(3, 40, 6))
    if alike:  # to the last digit, beside which their prior vanishes
        rows[:, 10:, 4:], rows[:, :10, 2:4] = 0.0, 0.0
        rows[:, 10:, 2:4] = 1e9
    sums = np.einsum("wsi,wsj->wij", rows, rows)
    return NormalEquations(sums, np.array([0, 3]), np.zeros((1, 2)), np.array([1e3, 1e3]), 1)


def test_hidden_states_that_do_the_same_share_what_they_explain():
    equations = of_two_states(alike=True)
    normal, gradient = equations.reduced()
    assert np.isfinite(normal).all()
    assert np.isfinite(gradient).all()
    _, ((first, second),) = equations.moves_with(np.zeros(1))
    np.testing.assert_allclose(first, second, rtol=1e-3)


def test_the_reduced_matrix_is_that_of_a_least_squares_fit_of_all():
    equations = of_two_states(alike=False)
    rows = np.random.default_rng(1).normal(size=(3, 40, 6))
    wide = np.zeros((3, 40, 3 + 6))
    for w in range(3):
        wide[w, :, :3], wide[w, :, 3 + 2 * w : 5 + 2 * w] = rows[w, :, 1:4], rows[w, :, 4:]
    design = wide.reshape(-1, 9)
    prior = np.zeros((2, 9))
    prior[[0, 1], [1, 2]] = 1e-3
    design = np.concatenate([design, prior])
    covariance = np.linalg.inv(design.T @ design)
    normal, _ = equations.reduced()
    np.testing.assert_allclose(normal, 1.0 / covariance[:1, :1], rtol=1e-9)
