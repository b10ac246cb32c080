"""Whoever helps answers what our own threads would, bit for bit."""

import base64
import zlib
from dataclasses import replace

import numpy as np
import pytest

from tests.support.simulated import recorded_twice as recorded
from trueup.canonical import digest_of
from trueup.diagnose.data_quality import assess
from trueup.diagnose.diagnosis import diagnose
from trueup.diagnose.problem_setup import Recordings, Setup
from trueup.diagnose.task_batch import pack_answers, pack_tasks, unpack_answers, unpack_tasks
from trueup.diagnose.task_worker import TaskWorker
from trueup.diagnose.tasks import Converge, Fit, Screen, in_threads
from trueup.fit.rollout_fit import Start
from trueup.model.block import kind
from trueup.model.series import refined


@pytest.fixture(scope="module")
def case():
    plant, episodes, _ = recorded("A1", ["quadratic_drag"], 21)
    return plant, episodes


@pytest.fixture(scope="module")
def posed(case):
    plant, episodes = case
    recordings = Recordings.of(plant, episodes)
    return Setup(recordings, assess(plant, recordings.adaptation), refined(plant)).problem(1)


def test_a_diagnosis_that_others_did_is_the_same(case):
    plant, episodes = case
    helper = TaskWorker(plant, list(reversed(episodes)))
    steps = set()

    def by_others(problem, tasks, told):
        steps.update(type(task) for task in tasks)
        halves = [tasks[: len(tasks) // 2], tasks[len(tasks) // 2 :]]
        answers = [unpack_answers(helper.answer(pack_tasks(problem, half))) for half in halves]
        told(1.0)
        return [*answers[0], *answers[1]]

    ours, theirs = diagnose(plant, episodes), diagnose(plant, episodes, solve=by_others)
    assert steps == {Screen, Fit, Converge}
    assert digest_of(dict(theirs.document)) == digest_of(dict(ours.document))
    assert (theirs.predictor.values, theirs.predictor.gain) == (
        ours.predictor.values,
        ours.predictor.gain,
    )


def test_a_batch_comes_out_as_it_went_in(posed):
    problem, base = posed
    values = base.fit.values.copy()
    values[:2] = np.nan, -np.inf
    odd = type(base.fit)(
        base.fit.hypothesis | "backlash",
        values,
        problem.fitter.free(base.fit.hypothesis | "backlash").none(),
        {
            digest: Start(start.windows, {("backlash", "played"): 0.1})
            for digest, start in base.fit.starts.items()
        },
        np.inf,
        base.fit.costs,
        3,
        np.zeros((0, 0)),
        False,
        np.zeros((len(base.fit.costs), 0)),
        np.inf,
    )
    tasks = [
        Screen(odd, "backlash", np.array([1.0, np.inf])),
        Fit(np.inf, "backlash", [odd, base.fit]),
        Converge(base),
    ]
    text = pack_tasks(problem, tasks)
    outline, again = unpack_tasks(text)
    assert (outline.scheme, outline.length_s, outline.base.cost) == (
        problem.scheme,
        problem.fits.length_s,
        base.fit.cost,
    )
    assert pack_tasks(replace(problem, base=outline.base), again) == text
    answers = pack_answers([base, [odd, base.fit]])
    assert pack_answers(unpack_answers(answers)) == answers


def test_a_candidate_is_worth_the_same_on_the_other_side(posed):
    _, base = posed
    (again,) = unpack_answers(pack_answers([base]))
    assert (again.reduced_chi_square, again.fit.by_episode, again.fit.parameters()) == (
        base.reduced_chi_square,
        base.fit.by_episode,
        base.fit.parameters(),
    )


@pytest.mark.parametrize("unpack", [unpack_tasks, unpack_answers])
def test_a_batch_unfolds_to_so_much_and_no_more(unpack, monkeypatch):
    monkeypatch.setattr("trueup.diagnose.task_batch.LARGEST", 1 << 16)
    with pytest.raises(ValueError, match="unfolds to more than 65536 bytes"):
        unpack(base64.b64encode(zlib.compress(bytes(1 << 20))).decode())


@pytest.mark.parametrize(
    "text",
    [
        "",
        "no base64!",
        base64.b64encode(b"not compressed").decode(),
        base64.b64encode(zlib.compress(b"{")).decode(),
    ],
)
def test_what_is_no_batch_is_refused(text):
    with pytest.raises((ValueError, KeyError, zlib.error)):
        unpack_tasks(text)


def test_tasks_are_answered_in_their_order_while_the_share_is_told(posed):
    problem, base = posed
    shares = []
    terms = ["backlash", "cubic_stiffness", "quadratic_drag"]
    tasks = [Screen(base.fit, term, np.zeros(len(kind(term).starts))) for term in terms]
    answers = in_threads(problem, tasks, shares.append)
    assert [{fit.hypothesis.effects for fit in answer} for answer in answers] == [
        {(term,)} for term in terms
    ]
    assert shares == pytest.approx([1 / 3, 2 / 3, 1.0])
