"""Model selection: which composition the evidence supports, and when none is supported."""

from types import SimpleNamespace

import numpy as np
import pytest

from trueup.diagnose.candidate import Candidate
from trueup.diagnose.model_selection import PHYSICAL, SIMULATED, Conclusion, select
from trueup.fit.rollout_fit import RolloutFit
from trueup.model.hypothesis import Hypothesis

WINDOWS, SAMPLES = 40, 4000  # on adaptation as on validation episodes


def fit(effects, misfit, numbers=3, *, helps_in=WINDOWS, without=None):
    """A fit whose windows all have this misfit; with `helps_in`, the others have the misfit that is
    left `without` it."""
    per_window = np.full(WINDOWS, misfit)
    if without is not None:
        per_window[helps_in:] = without
    costs, none = per_window * SAMPLES / WINDOWS, np.zeros(0)
    hypothesis = Hypothesis()
    for effect in effects:
        hypothesis = hypothesis | effect
    free = SimpleNamespace(rows=np.arange(numbers))
    return RolloutFit(
        hypothesis,
        none,
        free,
        {},
        float(costs.sum()),
        costs,
        SAMPLES,
        np.zeros((0, 0)),
        True,
        np.zeros((0, 0)),
    )


def candidate(*effects, misfit, numbers=None, **more):
    made = fit(effects, misfit, 3 + len(effects) if numbers is None else numbers, **more)
    return Candidate(made, made)


BASE = candidate(misfit=100.0)
NOMINAL = fit((), 150.0)


def test_an_effect_that_leaves_noise_alone_is_the_answer():
    choice = select([BASE, candidate("coulomb_friction", misfit=1.0)], NOMINAL)
    assert (choice.verdict, choice.winner.hypothesis.effects, choice.rivals) == (
        Conclusion.EFFECT,
        ("coulomb_friction",),
        (),
    )


def test_a_second_effect_that_removes_nothing_is_not_named():
    one, two = (
        candidate("coulomb_friction", misfit=1.0),
        candidate("coulomb_friction", "backlash", misfit=0.99),
    )
    assert select([BASE, one, two], NOMINAL).winner is one


def test_what_fits_as_well_is_a_rival_and_what_fits_worse_is_not():
    winner, alike, worse = (
        candidate(e, misfit=m)
        for e, m in (("coulomb_friction", 1.0), ("cogging", 1.0005), ("quadratic_drag", 1.5))
    )
    choice = select([BASE, winner, alike, worse], NOMINAL)
    assert choice.winner is winner
    assert choice.rivals == (alike,)


def test_a_gain_that_one_window_alone_shows_is_not_certain():
    lucky = candidate("coulomb_friction", misfit=1.0, helps_in=1, without=101.0)
    assert select([BASE, lucky], NOMINAL).winner is BASE


@pytest.mark.parametrize(
    ("criteria", "verdict"),
    [(SIMULATED, Conclusion.UNKNOWN), (PHYSICAL, Conclusion.EFFECT)],
)
def test_what_a_law_leaves_is_judged_by_where_it_was_recorded(criteria, verdict):
    """A tenth of the gap is left: no textbook law holds better on a machine, and every one does on
    a simulator."""
    assert (
        select([BASE, candidate("coulomb_friction", misfit=11.0)], NOMINAL, criteria).verdict
        is verdict
    )


def test_new_numbers_in_the_nominal_form_are_parameters_only_and_none_where_nothing_was_wrong():
    good = candidate(misfit=1.0)
    assert select([good], NOMINAL).verdict is Conclusion.PARAMETERS_ONLY
    assert select([good], good.check).verdict is Conclusion.NO_GAP


def test_outliers_that_happen_to_be_held_out_are_no_unknown_effect():
    left = candidate("coulomb_friction", misfit=3.0)
    assert select([BASE, left], NOMINAL).verdict is Conclusion.UNKNOWN
    assert select([BASE, left], NOMINAL, level=lambda _: 3.0).verdict is Conclusion.EFFECT
