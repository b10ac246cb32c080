"""A step of a search has the same answers whether helpers answer, die, decline or are absent."""

import threading
from dataclasses import replace

import numpy as np
import pytest

import trueup_worker.fan_out as module
from tests.support.simulated import recorded_twice as recorded
from trueup.diagnose.data_quality import assess
from trueup.diagnose.problem_setup import Recordings, Setup, searchable
from trueup.diagnose.task_batch import pack_answers
from trueup.diagnose.task_worker import TaskWorker
from trueup.diagnose.tasks import Screen, in_threads
from trueup.model.series import refined
from trueup_service.jobs import Help, Helped
from trueup_worker.compute_fingerprint import compute_fingerprint
from trueup_worker.fan_out import FanOut

TERMS = tuple(searchable()[:8])


class Others:
    """A queue in memory, whose batches fare as `fares` says."""

    def __init__(self, fares):
        self.fares, self.batches, self.withdrawn, self.asked = fares, {}, set(), []

    def ask_for_help(self, job, batches):
        self.asked.append(len(batches))
        self.batches |= {name: (job, offer) for name, offer in batches.items()}

    def help(self, names):
        states = {
            name: self.fares(*self.batches[name]) for name in names if name not in self.withdrawn
        }
        return {name: help_ for name, help_ in states.items() if help_ is not None}

    def withdraw(self, names):
        self.withdrawn.update(names)

    def forget(self, prefix):
        self.batches = {name: p for name, p in self.batches.items() if not name.startswith(prefix)}


@pytest.fixture(scope="module")
def case():
    plant, episodes, _ = recorded("A1", ["quadratic_drag"], 21)
    recordings = Recordings.of(plant, episodes)
    quality = assess(plant, recordings.adaptation)
    problem, base = Setup(recordings, quality, refined(plant)).problem(1)
    tasks = [Screen(base.fit, term, np.zeros(1)) for term in TERMS]
    return (
        TaskWorker(plant, episodes),
        problem,
        tasks,
        pack_answers(in_threads(problem, tasks, lambda _: None)),
    )


@pytest.fixture(autouse=True)
def one_core(monkeypatch):
    monkeypatch.setattr(module, "cores", lambda: 1)
    monkeypatch.setattr(module, "POLL_S", 0.001)
    monkeypatch.setattr(module, "PATIENCE_S", 0.0)
    monkeypatch.setattr(module, "PATIENCE", 0.01)


def helpful(helper):
    def fares(job, offer):
        assert job == "job"
        fingerprint, text = offer.split(" ")
        assert fingerprint == compute_fingerprint()
        return Help(Helped.DONE, helper.answer(text))

    return fares


FARES = {
    "nobody is there": lambda _: lambda *_: Help(Helped.WAITING, None),
    "somebody helps": helpful,
    "somebody took it and died": lambda _: lambda *_: Help(Helped.TAKEN, None),
    "somebody answers nonsense": lambda _: lambda *_: Help(Helped.DONE, "bm9uc2Vuc2U="),
    "somebody answers another question": lambda _: lambda *_: Help(Helped.DONE, pack_answers([])),
    "somebody declines": lambda _: lambda *_: Help(Helped.DONE, ""),
    "the engine gave it up": lambda _: lambda *_: Help(Helped.FAILED, None),
    "it is gone": lambda _: lambda *_: None,
}


@pytest.mark.parametrize("fares", FARES)
def test_the_answers_are_the_same_where(case, fares):
    helper, problem, tasks, expected = case
    others, shares = Others(FARES[fares](helper)), []
    with FanOut(others, "job") as fan_out:
        assert pack_answers(fan_out(problem, tasks, shares.append)) == expected
        assert pack_answers(fan_out(problem, tasks, shares.append)) == expected
    assert others.asked == [
        len(tasks) - 1,
        len(tasks) - 1 if fares in ("somebody helps", "somebody took it and died") else 1,
    ]
    assert not others.batches
    assert max(shares) == 1.0


def test_one_batch_is_offered_while_nobody_helps_and_all_once_somebody_does(case):
    helper, problem, tasks, _ = case
    there = threading.Event()
    others = Others(
        lambda *p: helpful(helper)(*p) if there.is_set() else Help(Helped.WAITING, None)
    )
    with FanOut(others, "job") as fan_out:
        for step in range(4):
            if step == 2:
                there.set()
            # as batches that are new
            fan_out(
                problem, [replace(t, expected=t.expected + step) for t in tasks], lambda _: None
            )
    assert others.asked == [7, 1, 1, 7]


def test_a_batch_has_the_name_of_its_content(case):
    _, problem, tasks, _ = case
    names = []
    for _ in range(2):
        others = Others(lambda *_: Help(Helped.WAITING, None))
        with FanOut(others, "job") as fan_out:
            fan_out(problem, tasks, lambda _: None)
            names.append(set(others.batches))
    assert names[0] == names[1]
    assert all(name.startswith("help.job.") for name in names[0])


def test_a_cancelled_job_takes_back_what_it_asked_for(case):
    _, problem, tasks, _ = case
    others = Others(lambda *_: Help(Helped.TAKEN, None))

    def cancel(_):
        raise InterruptedError

    with pytest.raises(InterruptedError), FanOut(others, "job") as fan_out:
        fan_out(problem, tasks, cancel)
    assert len(others.withdrawn) == len(tasks) - 1
    assert not others.batches


def test_a_task_that_fails_fails_the_step(case):
    _, problem, tasks, _ = case
    others = Others(lambda *_: Help(Helped.WAITING, None))
    broken = Screen(tasks[0].parent, "no such effect", np.zeros(1))
    with pytest.raises(KeyError), FanOut(others, "job") as fan_out:
        fan_out(problem, [broken, *tasks], lambda _: None)
