"""Convergence: a minimum is proven, the same from wherever a fit begins, and every minimum that the
data allow is kept."""

from dataclasses import replace

import numpy as np
import pytest

from tests.support.simulated import recorded
from trueup.diagnose.data_quality import assess
from trueup.diagnose.intervals import Minima, half_widths, intervals
from trueup.fit.convergence import PROVEN, converge, minima
from trueup.fit.fitter import Fitter
from trueup.fit.free_numbers import Directions
from trueup.fit.multiple_shooting import best_of_scattered, estimate_starts
from trueup.fit.rollout_fit import Start
from trueup.model.hypothesis import Hypothesis
from trueup.model.rounding import STEP_BITS, rounded
from trueup.model.series import refined, series
from trueup.simulate.noise import NoiseModel

FRICTION = Hypothesis(("coulomb_friction",))


@pytest.fixture(scope="module")
def posed():
    return _posed(recorded("B1", ["coulomb_friction"], 18))


def _posed(of, correlation=None):
    plant, episodes, trial = of
    adaptation = [e for e in episodes if e.role == "adaptation"]
    admission = assess(plant, adaptation)
    fitter = Fitter(
        plant.form,
        Directions.of_family(plant.dynamics.parameter_names),
        admission.scales,
        trial.sigma,
        correlation,
    )
    data = [series(plant, e, refined(plant), 2.0) for e in adaptation]
    values = fitter.with_effect(fitter.initial_values(plant.parameters), "coulomb_friction", (0.2,))
    return fitter, data, fitter.fit(data, FRICTION, values), trial


def test_a_minimum_is_proven_and_the_same_from_far_to_both_sides(posed):
    fitter, data, fit, _ = posed
    best = converge(fitter, data, fit)
    assert best.converged
    assert best.distance <= PROVEN
    widths = np.array(list(half_widths(best, best).values()))
    for side in (-3.0, 3.0):
        values = best.free.moved(best.values, side * widths)
        other = converge(
            fitter, data, fitter.fit(data, FRICTION, values, best.starts, iterations=4)
        )
        assert other.converged
        assert np.abs(other.free.at(other.values) - best.free.at(best.values)) == pytest.approx(
            0.0, abs=0.02 * widths.max()
        )


def test_a_proven_minimum_costs_no_more_than_its_neighbours(posed):
    fitter, data, fit, _ = posed
    best = converge(fitter, data, fit)
    widths = np.array(list(half_widths(best, best).values()))
    for which in range(len(widths)):
        for side in (-0.5, 0.5):
            values = best.free.moved(best.values, side * widths * (np.arange(len(widths)) == which))
            assert estimate_starts(fitter, data, FRICTION, values, best.starts).cost > best.cost


def test_where_errors_grow_within_a_window_its_start_is_found_by_steps_as_short_as_the_log_tells():
    plant, episodes, trial = recorded("B1", ["cogging"], 1)
    fitter, data, _, _ = _posed((plant, episodes, trial))
    cogging, machine = Hypothesis(("cogging",)), trial.machine
    law = machine.imperfections["cogging"]
    values = fitter.initial_values(
        [
            {"k": machine.k, "c": machine.c, "b": machine.b}[n]
            for n in plant.dynamics.parameter_names
        ]
    )
    rows = fitter.block.rows_of("cogging")
    values[rows["sine"]] = law["amplitude"] * np.cos(law["phase"])
    values[rows["cosine"]] = law["amplitude"] * np.sin(law["phase"])
    values[rows["pitch"]] = law["pitch"]
    coarse, fine = (
        estimate_starts(fitter, data, cogging, values, iterations=25, fine=fine)
        for fine in (False, True)
    )
    assert fine.reduced_chi_square < coarse.reduced_chi_square - 0.02
    assert fine.reduced_chi_square < 1.05


def test_windows_that_forget_are_not_rolled_out_again_to_be_mixed(posed, monkeypatch):
    """Some windows' tried starts are worse, and stay where they were: the same starts and cost as
    by another rollout, which a composition that remembers takes."""
    fitter, data, fit, _ = posed
    assert fitter.forgets(FRICTION)
    assert not fitter.forgets(Hypothesis(("hysteresis",)))
    rng, astray = np.random.default_rng(5), {}
    for s in data:
        windows = fit.starts[s.digest].windows
        off = rng.uniform(-1.0, 1.0, windows.shape) * [2e4, 2e5] * fitter.sigma
        astray[s.digest] = Start(windows + off, {})
    counted = []
    evaluate = Fitter.evaluate
    monkeypatch.setattr(Fitter, "evaluate", lambda *args: (counted.append(1), evaluate(*args))[1])
    mixed = estimate_starts(fitter, data, FRICTION, fit.values, astray)
    many = len(counted)
    monkeypatch.setattr(Fitter, "forgets", lambda *_: False)
    again = estimate_starts(fitter, data, FRICTION, fit.values, astray)
    assert len(counted) - many > many
    assert mixed.cost == again.cost
    for key, start in mixed.starts.items():
        assert (start.windows == again.starts[key].windows).all()


def test_a_start_in_another_valley_is_found_around(posed):
    fitter, data, fit, _ = posed
    astray = {}
    for s in data:
        windows = fit.starts[s.digest].windows.copy()
        windows[0, 1] += 2.5 * fitter.sigma[1]
        astray[s.digest] = Start(windows, {})
    found = best_of_scattered(fitter, data, FRICTION, fit.values, astray)
    costs = [
        estimate_starts(fitter, data, FRICTION, fit.values, starts, iterations=0).cost
        for starts in (astray, found)
    ]
    assert costs[1] < 0.9 * costs[0]


def test_intervals_hold_the_truth_and_span_every_minimum(posed):
    fitter, data, fit, trial = posed
    found = minima(fitter, data, fit)
    assert len(found) == 1
    low, high = intervals(Minima(found, found[0]))["coulomb_friction", "level"]
    truth = trial.machine.imperfections["coulomb_friction"]["level"]
    assert low < truth < high
    elsewhere = replace(
        found[0], values=found[0].free.moved(found[0].values, np.array([0.0, 0.0, 0.0, high - low]))
    )
    lower, higher = intervals(Minima([found[0], elsewhere], found[0]))["coulomb_friction", "level"]
    assert lower <= low
    assert higher > high


def test_where_something_else_acts_intervals_are_as_wide_as_recordings_disagree():
    fitter, data, fit, _ = _posed(recorded("B1", ["coulomb_friction", "cubic_stiffness"], 18))
    best = converge(fitter, data, fit)
    assert best.reduced_chi_square > 2.0
    alone = replace(best, scores=np.zeros_like(best.scores))
    wide, narrow = (half_widths(f, f)["coulomb_friction", "level"] for f in (best, alone))
    assert wide > 1.5 * narrow


def test_errors_under_coloured_noise_are_taken_less_what_was_expected():
    of = recorded("B1", ["coulomb_friction"], 18, law=NoiseModel(0.9))
    (fitter, data, fit, _), (plain, _, white, _) = _posed(of, np.full(2, 0.9)), _posed(of)
    assert fit.reduced_chi_square == pytest.approx(1.0, abs=0.15)
    ratio = [half_widths(f, f)["", "k"] for f in (fit, white)]
    assert ratio[0] > 1.5 * ratio[1]  # samples that repeat each other tell less
    fresh = fitter.fit(data, FRICTION, fit.values, fit.starts, iterations=0)
    assert fresh.cost == pytest.approx(fit.cost)
    assert plain.correlation.tolist() == [0.0, 0.0]


def test_what_a_last_bit_decides_is_cut_off():
    x = np.random.default_rng(1).normal(size=1000) * 10.0 ** np.arange(-500, 500, 1).clip(-200, 200)
    assert np.abs(rounded(x) - x).max() <= np.abs(x).max() * 2.0**-STEP_BITS
    assert (np.abs(rounded(x) / x - 1.0) <= 2.0**-STEP_BITS).all()
    assert (rounded(x * (1.0 + 1e-15)) == rounded(x)).mean() == 1.0
    assert rounded(np.array([0.0, np.inf, -np.inf])).tolist() == [0.0, np.inf, -np.inf]
    assert np.isnan(rounded(np.nan))
