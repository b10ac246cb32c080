"""A second look at a machine that no composition explains: what certainly acts, by predictions of
every recording."""

from dataclasses import dataclass, field
from types import SimpleNamespace

import numpy as np
import pytest

from tests.support.simulated import recorded_twice
from trueup.diagnose import second_look as module
from trueup.diagnose.by_prediction import Predictors
from trueup.diagnose.data_quality import assess
from trueup.diagnose.explore import explore
from trueup.diagnose.model_selection import PHYSICAL, Choice, Conclusion
from trueup.diagnose.problem_setup import Recordings
from trueup.diagnose.second_look import (
    Predicted,
    certain_of_the_rest,
    predictions,
    second_look,
)
from trueup.model.hypothesis import Hypothesis

BASE = np.array([1.0, 2.0, 1.0, 4.0])


@dataclass(frozen=True, eq=False)
class Made:
    """A candidate with the errors that its predictions have: held out, and of each recording."""

    names: tuple[str, ...]
    held_out: float
    errors: np.ndarray = field(default_factory=lambda: BASE)
    total: float = 1.0

    @property
    def hypothesis(self):
        return Hypothesis(self.names)

    @property
    def fit(self):
        return SimpleNamespace(cost=self.total)


def looked(monkeypatch, made, *, physical=True, recordings=3, verdict=Conclusion.UNKNOWN):
    base = Made((), 0.5)
    monkeypatch.setattr(
        module, "predictions", lambda candidates, _: [Predicted(c, c.errors) for c in candidates]
    )
    search = type("Search", (), {"base": base, "__iter__": lambda _: iter([base, *made])})()
    predictors = SimpleNamespace(
        search=search,
        recordings=SimpleNamespace(
            strategy=SimpleNamespace(robot=False, physical=physical),
            criteria=PHYSICAL,
            adaptation=[SimpleNamespace(recording=str(i)) for i in range(recordings)],
        ),
        nominal_error=0.6,
        error=lambda c: c.held_out,
        errors=lambda candidates: [c.held_out for c in candidates],
    )
    return second_look(Choice(verdict, base, (), 0.7), predictors)


def test_a_part_that_certainly_acts_is_named_though_its_law_is_incomplete(monkeypatch):
    friction = Made(("coulomb_friction",), 0.45, 0.3 * BASE)
    choice = looked(monkeypatch, [friction, Made(("backlash",), 0.4, 0.9 * BASE)])
    assert (choice.verdict, choice.winner, choice.partial) == (Conclusion.EFFECT, friction, True)
    assert choice.left == pytest.approx(0.3)
    assert choice.rivals == ()


def test_what_leaves_hardly_anything_is_an_answer_and_what_is_alike_its_rival(monkeypatch):
    first, second = Made(("a",), 0.1, 0.1 * BASE), Made(("b",), 0.1, 0.11 * BASE)
    choice = looked(monkeypatch, [second, first])
    assert (choice.winner, choice.rivals, choice.partial) == (first, (second,), False)


@pytest.mark.parametrize(
    "made",
    [
        pytest.param(Made(("a",), 0.45, 0.6 * BASE), id="it leaves more than half"),
        pytest.param(
            Made(("a",), 0.45, np.array([0.1, 0.1, 1.1, 1.2 * 4.0])), id="two recordings object"
        ),
        pytest.param(Made(("a",), 0.55, 0.1 * BASE), id="held-out recordings are worse"),
        pytest.param(Made(("a", "b"), 0.1, 0.1 * BASE), id="two effects"),
    ],
)
def test_else_the_choice_stands(monkeypatch, made):
    assert looked(monkeypatch, [made]).verdict is Conclusion.UNKNOWN


def test_it_is_for_machines_with_recordings_to_leave_out_that_nothing_explains(monkeypatch):
    made = [Made(("a",), 0.45, 0.1 * BASE)]
    assert looked(monkeypatch, made).verdict is Conclusion.EFFECT
    assert looked(monkeypatch, made, physical=False).verdict is Conclusion.UNKNOWN
    assert looked(monkeypatch, made, recordings=2).verdict is Conclusion.UNKNOWN
    kept = looked(monkeypatch, made, verdict=Conclusion.PARAMETERS_ONLY)
    assert kept.verdict is Conclusion.PARAMETERS_ONLY


def of_the_rest(monkeypatch, winner, others, *, put_aside=True):
    """What is said of an answer to recordings of which something was put aside."""
    base = Made((), 0.5)
    monkeypatch.setattr(
        module, "predictions", lambda candidates, _: [Predicted(c, c.errors) for c in candidates]
    )
    monkeypatch.setattr(module, "numbers_of", lambda c: len(c.names))
    search = type("Search", (), {"base": base, "__iter__": lambda _: iter([base, *others])})()
    recordings = SimpleNamespace(put_aside=["a stretch"] * put_aside, criteria=PHYSICAL)
    predictors = SimpleNamespace(search=search, recordings=recordings)
    return certain_of_the_rest(Choice(Conclusion.EFFECT, winner, (), 0.1), predictors)


def test_of_trimmed_recordings_what_predicts_alike_is_told_and_the_fewest_numbers_are_the_answer(
    monkeypatch,
):
    pair = Made(("a", "b"), 0.1, 0.10 * BASE)
    alone, worse = Made(("c",), 0.1, 0.11 * BASE), Made(("d",), 0.1, 0.2 * BASE)
    choice = of_the_rest(monkeypatch, pair, [worse, alone])
    assert (choice.verdict, choice.winner, choice.rivals) == (Conclusion.EFFECT, alone, (pair,))
    assert of_the_rest(monkeypatch, pair, [alone], put_aside=False).winner is pair


def test_of_trimmed_recordings_an_answer_must_certainly_act(monkeypatch):
    faint = Made(("a",), 0.1, 0.6 * BASE)
    assert of_the_rest(monkeypatch, faint, []).verdict is Conclusion.UNKNOWN


def of_robot(made, missed):
    """A second look at a robot: `missed` says which candidates windows are predicted better by than
    by which others."""
    base = Made((), 0.5)
    search = type("Search", (), {"base": base, "__iter__": lambda _: iter([base, *made])})()
    predictors = SimpleNamespace(
        search=search,
        recordings=SimpleNamespace(
            strategy=SimpleNamespace(robot=True, physical=True), criteria=PHYSICAL, validation=[]
        ),
        nominal_error=0.6,
        error=lambda c: c.held_out,
        errors=lambda candidates: [c.held_out for c in candidates],
        misses=lambda part, whole, _=None: (part.names, whole.names) in missed,
    )
    return second_look(Choice(Conclusion.UNKNOWN, base, (), 0.7), predictors)


def test_of_a_robot_the_kind_of_effect_that_windows_certainly_need_and_fits_best_is_named():
    both = Made(("coulomb_friction", "coulomb_friction@1"), 0.3, total=2.0)
    one = Made(("coulomb_friction@1",), 0.34, total=3.0)
    uneven = Made(("gain_asymmetry",), 0.2, total=1.0)
    pair = Made(("backlash", "coulomb_friction"), 0.1, total=0.5)
    made = [uneven, one, both, pair]
    missed = {((), both.names), ((), one.names)}  # new numbers are worse than these
    choice = of_robot(made, missed)
    assert (choice.verdict, choice.winner, choice.rivals) == (Conclusion.EFFECT, both, (one,))
    assert choice.left == pytest.approx(0.36)
    assert choice.partial
    assert of_robot(made, {*missed, (one.names, both.names)}).rivals == ()


@pytest.mark.parametrize(
    ("held_out", "missed"), [(0.3, False), (0.45, True), (0.51, True)],
    ids=["windows do not tell", "it leaves more than half", "it predicts worse"],
)  # fmt: skip
def test_else_a_robot_stays_unknown(held_out, missed):
    made = Made(("coulomb_friction",), held_out)
    choice = of_robot([made], {((), made.names)} if missed else set())
    assert choice.verdict is Conclusion.UNKNOWN


def test_each_fitted_recording_is_predicted_by_a_fit_without_it():
    plant, episodes, _ = recorded_twice("A1", ["coulomb_friction"], 11)
    recordings = Recordings.of(plant, episodes)
    explored = explore(recordings, assess(plant, recordings.adaptation), lambda *_: None)
    search = explored.search
    friction = search.candidates[Hypothesis(("coulomb_friction",))]
    predictors = Predictors(recordings, explored.searched.quality, search)
    base, answer = predictions([search.base, friction], predictors)
    assert base.errors.shape == answer.errors.shape == (len(episodes),)
    assert (answer.errors < 0.1 * base.errors).all()
    whole = predictors.predictor(friction.fit)
    fitted = module._error(whole, recordings.adaptation[:1], recordings.every)
    assert answer.errors[0] > fitted
