"""No model is served that predicts held-out recordings worse than the one it would replace."""

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest

from tests.support.simulated import recorded
from trueup.diagnose import by_prediction
from trueup.diagnose.by_prediction import (
    Predictors,
    best_of_the_alike,
    fallback,
    predicts_worse,
    without_idle,
)
from trueup.diagnose.diagnosis import diagnose
from trueup.diagnose.measure import Gap
from trueup.diagnose.model_selection import Choice, Conclusion
from trueup.diagnose.summary_text import sentence
from trueup.diagnose.summary_warnings import warnings
from trueup.episode.role import Role
from trueup.model.hypothesis import Hypothesis
from trueup.model.predictor import Nominal


@dataclass(frozen=True, eq=False)
class Made:
    """A candidate with the error that its predictions have."""

    name: str
    error: float
    total: float = 1.0
    reduced_chi_square: float = 5.0
    numbers: int = 3

    @property
    def hypothesis(self):
        return Hypothesis((self.name,))

    @property
    def fit(self):
        free = SimpleNamespace(rows=np.zeros(self.numbers - 1))
        return SimpleNamespace(free=free, starts={"e": SimpleNamespace(memory={"x": 0.0})})


class Errors:
    """Predictors whose errors are known."""

    def __init__(self, candidates=(), base=None, *, of_machine=False):
        criteria = SimpleNamespace(of_machine=of_machine, unexplained=0.15)
        self.recordings = SimpleNamespace(criteria=criteria)
        self.search = type("Search", (), {"base": base, "__iter__": lambda _: iter(candidates)})()

    def errors(self, candidates):
        return [c.error for c in candidates]

    def misses(self, part, whole):
        return True


def gap(after, before=0.4, same=0.4, numbers=0.2):
    return Gap(1.0, before, same, numbers, after, 0.01, 0.5, None, {})


def test_of_compositions_that_are_alike_the_one_that_predicts_much_better_is_the_answer():
    first, second, third = Made("a", 0.5), Made("b", 0.2), Made("c", 0.3)
    choice = Choice(Conclusion.EFFECT, first, (second, third), 0.1)
    chosen = best_of_the_alike(choice, Errors())
    assert chosen.winner is second
    assert chosen.rivals == (first, third)
    assert best_of_the_alike(replace(choice, winner=Made("a", 0.21)), Errors()).winner.name == "a"


def test_on_a_machine_fewer_numbers_that_predict_about_as_well_are_the_answer():
    """A hidden state that starts anywhere may stand for what one number says."""
    winding = Made("winding", 0.20, numbers=9)
    plain, worse = Made("plain", 0.21, numbers=5), Made("worse", 0.3, numbers=4)
    choice = Choice(Conclusion.EFFECT, winding, (worse, plain), 0.1)
    chosen = best_of_the_alike(choice, Errors(of_machine=True))
    assert chosen.winner is plain
    assert chosen.rivals == (winding, worse)
    assert best_of_the_alike(choice, Errors()) == choice
    alone = replace(choice, rivals=(worse,))
    assert best_of_the_alike(alone, Errors(of_machine=True)) == alone


@pytest.mark.parametrize(
    ("after", "worse"), [(0.19, False), (0.2, False), (0.21, True), (0.5, True)]
)
def test_an_answer_must_predict_no_worse_than_the_refitted_nominal_form(after, worse):
    assert predicts_worse(gap(after)) is worse
    assert predicts_worse(gap(after, numbers=0.9)) is (after > 0.4)


def test_the_nearest_is_what_predicts_best_and_is_no_answer():
    base = Made("nothing", 0.3)
    tried = [Made("a", 0.9, 1.0), Made("b", 0.1, 2.0), Made("c", 0.4, 3.0)]
    choice = Choice(Conclusion.EFFECT, tried[0], (), 0.1)
    nearest, better = fallback(choice, Errors(tried, base), 0.3)
    assert (nearest.verdict, nearest.winner, better) == (Conclusion.UNKNOWN, tried[1], True)
    nearest, better = fallback(choice, Errors(tried[:1], base), 0.2)
    assert (nearest.winner, better) == (base, False)


@pytest.mark.slow
def test_a_machine_that_changed_after_it_was_fitted_keeps_its_nominal_model():
    """The recordings that are fitted are of a joint that rubs, those held out of one without: what
    fits the first predicts the others worse than the nominal model does."""
    plant, rubbing, _ = recorded("A1", ["coulomb_friction"], 11, shifted=False)
    _, free, _ = recorded("A1", [], 11, shifted=False)
    episodes = [e for e in rubbing if e.role is Role.ADAPTATION]
    episodes += [e for e in free if e.role is Role.VALIDATION]
    diagnosis = diagnose(plant, episodes)
    report = diagnosis.document
    assert report["verdict"] in ("unknown_effect", "no_gap")
    assert report["evidence"]["served"] == "nominal"
    assert report["effects"] == []
    assert report["parameters"] == {}
    assert report["gap"]["after"] <= 1.01 * report["gap"]["before"]
    assert any("better than the nominal model" in w for w in warnings(report))
    assert sentence(report)
    states, command = np.array([[0.1, -0.2]]), np.array([[0.3]])
    np.testing.assert_allclose(
        diagnosis.predictor.predict_batch(states, command),
        Nominal(plant).predict_batch(states, command),
    )


def test_an_effect_that_its_interval_denies_and_predictions_do_not_miss_is_left_out(monkeypatch):
    """Of the three effects one is denied and needed, and one is denied and idle."""

    @dataclass(frozen=True, eq=False)
    class Fitted:
        hypothesis: Hypothesis
        error: float
        reduced_chi_square: float = 2.0

    needed = {"coulomb_friction", "actuator_delay"}

    def fitted(hypothesis, _):
        return Fitted(hypothesis, 0.2 if needed <= set(hypothesis.effects) else 0.9)

    winner = Fitted(Hypothesis(("actuator_delay", "constant_force", "coulomb_friction")), 0.2)
    predictors = Errors(base=SimpleNamespace(reduced_chi_square=11.0), of_machine=True)
    predictors.search.fitted = fitted
    denied = ["coulomb_friction", "constant_force"]
    monkeypatch.setattr(
        by_prediction, "_denied", lambda c: [t for t in denied if t in c.hypothesis.effects]
    )
    choice = Choice(Conclusion.EFFECT, winner, (), 0.1)
    assert set(without_idle(choice, predictors).winner.hypothesis.effects) == needed
    predictors.recordings.criteria.of_machine = False
    assert without_idle(choice, predictors) is choice


@pytest.mark.parametrize(("left", "partial"), [(2.0, False), (6.0, True)])
def test_an_effect_that_most_windows_do_not_miss_is_left_out(monkeypatch, left, partial):
    """Mean squares prefer the whole; what is left of it says by itself how much it leaves."""

    @dataclass(frozen=True, eq=False)
    class Fitted:
        hypothesis: Hypothesis
        error: float
        reduced_chi_square: float = left

    monkeypatch.setattr(by_prediction, "_denied", lambda _: [])
    predictors = Errors(base=SimpleNamespace(reduced_chi_square=11.0), of_machine=True)
    predictors.search.fitted = lambda hypothesis, _: Fitted(hypothesis, 0.9)
    predictors.misses = lambda part, _: "coulomb_friction" not in part.hypothesis.effects
    terms = ("gain_asymmetry", "coulomb_friction", "gain_asymmetry@1", "coulomb_friction@1")
    choice = Choice(Conclusion.EFFECT, Fitted(Hypothesis(terms), 0.2), (), 0.05)
    after = without_idle(choice, predictors)
    assert after.winner.hypothesis.effects == ("coulomb_friction", "coulomb_friction@1")
    assert after.left == pytest.approx((left - 1.0) / 10.0)
    assert after.partial is partial


def test_a_few_wild_windows_do_not_outvote_the_others(monkeypatch):
    """The whole halves the error of the two windows in which it is largest, and makes all others
    worse; then it makes all a little better."""
    part = np.concatenate([np.full(18, 1e-3), [1.0, 2.0]])
    wild = np.concatenate([np.full(18, 1.2e-3), [0.5, 1.0]])
    errors = {"part": part, "wild": wild, "better": 0.9 * part}
    monkeypatch.setattr(by_prediction, "knows_beginnings", lambda _: True)
    monkeypatch.setattr(by_prediction, "windows_of", lambda *_, **__: [])
    monkeypatch.setattr(by_prediction, "squared_errors", lambda p, *_: errors[p])
    predictors = Predictors(
        SimpleNamespace(plant=SimpleNamespace(horizon_s=1.0), every=[]),
        SimpleNamespace(motion=None),
        None,
    )
    monkeypatch.setattr(Predictors, "predictor", lambda _, fit: fit)
    of = {name: SimpleNamespace(fit=name) for name in errors}
    assert not predictors.misses(of["part"], of["wild"])
    assert predictors.misses(of["part"], of["better"])
    errors["part"] = errors["better"] = part[:3]
    assert predictors.misses(of["part"], of["better"])  # three windows cannot tell


def test_an_interval_that_holds_no_effect_denies_it():
    plant, episodes, _ = recorded("A1", ["coulomb_friction"], 11, runs=2)
    search = diagnose(plant, episodes).search
    true = search.candidates[Hypothesis(("coulomb_friction",))]
    both = search.fitted(true.hypothesis | "constant_force", true)
    assert by_prediction._denied(true) == []
    assert by_prediction._denied(both) == ["constant_force"]
