"""A job's parts are queued once, answered in order, and none is left when the job ends."""

import pytest

import trueup_worker.spread as module
from trueup_service.jobs import JobPart, PartState
from trueup_worker.spread import ATTEMPTS, PartFailed, Spread

ASKED = [{"case": i} for i in range(5)]
PROBLEM = {"code": "not-identifiable", "detail": "why", "hint": "what to do", "facts": {"n": "1"}}


class Engine:
    """An engine in memory, whose parts fare as `fares` says of what is asked and how often."""

    def __init__(self, fares):
        self.fares, self.asked, self.looks, self.resumed = fares, {}, {}, []

    def names(self, prefix):
        return [name for name in self.asked if name.startswith(prefix)]

    def spread(self, job, parts):
        assert not set(parts) & set(self.asked)
        self.asked |= parts

    def parts(self, names):
        found = {}
        for name in names:
            if name in self.asked:
                self.looks[name] = self.looks.get(name, 0) + 1
                found[name] = self.fares(self.asked[name], self.looks[name])
        return {name: part for name, part in found.items() if part is not None}

    def resume(self, name):
        self.resumed.append(name)

    def remove(self, names):
        for name in names:
            self.asked.pop(name)


@pytest.fixture(autouse=True)
def no_waiting(monkeypatch):
    monkeypatch.setattr(module, "POLL_S", 0.0)


def done(asked):
    return JobPart(PartState.DONE, {"answer": asked["case"] * 10})


def answers(engine, progress=lambda _: None):
    with Spread(engine, "job") as spread:
        return list(spread(ASKED, progress))


def test_answers_come_in_order_whatever_is_done_first():
    engine, shares = (
        Engine(
            lambda asked, looks: (
                done(asked) if looks > 5 - asked["case"] else JobPart(PartState.UNDER_WAY, None)
            )
        ),
        [],
    )
    assert answers(engine, shares.append) == [0, 10, 20, 30, 40]
    assert shares == sorted(shares)
    assert engine.asked == {}


def test_a_part_that_the_engine_gave_up_is_queued_again():
    engine = Engine(
        lambda asked, looks: done(asked) if looks > ATTEMPTS else JobPart(PartState.FAILED, None)
    )
    assert answers(engine) == [0, 10, 20, 30, 40]
    assert len(engine.resumed) == ATTEMPTS * len(ASKED)


def test_a_part_that_the_engine_gives_up_each_time_fails_the_job():
    engine = Engine(lambda *_: JobPart(PartState.FAILED, None))
    with pytest.raises(PartFailed) as raised:
        answers(engine)
    assert raised.value.code == "given-up"
    assert engine.asked == {}


def test_a_part_with_a_problem_fails_the_job_with_that_problem():
    engine = Engine(lambda *_: JobPart(PartState.DONE, {"problem": PROBLEM}))
    with pytest.raises(PartFailed, match="why") as raised:
        answers(engine)
    assert (raised.value.code, raised.value.hint) == ("not-identifiable", "what to do")
    assert raised.value.facts == {"n": "1"}


def test_what_a_job_asked_before_it_was_begun_again_is_removed_or_used():
    engine = Engine(lambda asked, _: done(asked))
    with Spread(engine, "job") as spread:
        list(spread(ASKED, lambda _: None))
        before = dict(engine.asked)
        engine.asked["part.job.of-another-draw"] = {"case": 9}
        engine.asked["part.another-job.x"] = {"case": 9}
        assert list(spread(ASKED, lambda _: None)) == [0, 10, 20, 30, 40]
        assert engine.asked == {**before, "part.another-job.x": {"case": 9}}
    assert list(engine.asked) == ["part.another-job.x"]


def test_a_part_that_was_removed_under_the_job_is_queued_again():
    engine = Engine(lambda asked, looks: done(asked) if looks > 1 else None)
    queued = []
    engine.spread = lambda job, parts: (queued.extend(parts), engine.asked.update(parts))
    assert answers(engine) == [0, 10, 20, 30, 40]
    assert len(queued) == 2 * len(ASKED)


def test_a_cancelled_job_takes_its_parts_back():
    engine = Engine(lambda *_: JobPart(PartState.UNDER_WAY, None))

    def cancel(_):
        raise InterruptedError

    with pytest.raises(InterruptedError):
        answers(engine, cancel)
    assert engine.asked == {}
