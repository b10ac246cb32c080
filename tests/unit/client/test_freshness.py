"""How old observations and the serving model are, held against a timeout by the robot itself."""

import itertools
import math

import pytest

from trueup_client import Client, Freshness


class Clock:
    def __init__(self):
        self.now = 100.0

    def __call__(self):
        return self.now


def test_before_the_first_of_either_nothing_is_fresh():
    ages = Freshness(0.1, 60.0, Clock()).ages()
    assert (ages.fresh, ages.stale) == (False, ("observation", "model"))
    assert ages.model_s == math.inf


def test_each_ages_by_itself_and_is_stale_after_its_own_timeout():
    clock = Clock()
    fresh = Freshness(0.125, 60.0, clock)
    fresh.observed()
    fresh.confirmed()
    clock.now += 0.125  # which a float holds as it is
    assert (fresh.ages().fresh, fresh.ages().observation_s) == (True, 0.125)
    clock.now += 0.01
    assert fresh.ages().stale == ("observation",)
    fresh.observed()
    clock.now += 60.0
    assert fresh.ages().stale == ("observation", "model")


def test_an_observation_that_came_late_is_as_old_as_it_is_and_never_makes_a_younger_one_older():
    clock = Clock()
    fresh = Freshness(0.1, 60.0, clock)
    fresh.observed()
    fresh.observed(age_s=0.5)
    assert fresh.ages().observation_s == 0.0
    clock.now += 1.0
    fresh.observed(age_s=0.05)
    assert fresh.ages().observation_s == pytest.approx(0.05)


@pytest.mark.parametrize("timeouts", [(0.0, 1.0), (1.0, -1.0), (float("nan"), 1.0)])
def test_a_timeout_that_is_none_is_refused(timeouts):
    with pytest.raises(ValueError, match="positive"):
        Freshness(*timeouts)


def test_a_watch_confirms_the_model_at_every_answer(monkeypatch):
    answers = itertools.cycle([(200, {"ETag": '"1"'},
    b'{"plant": "p", "version": 1, "artifact": "a", "generation": 1, "since": "t",'
                               b' "decision": null, "move": "registered", "actor": "x"}'), (304,
                               {}, b"")])  # fmt: skip
    client, times = Client("http://127.0.0.1:1"), []
    monkeypatch.setattr(client._connection, "tagged", lambda *_: next(answers))
    watch = client.watch("p", 0.0, lambda: times.append(1))
    next(watch)
    next(watch)
    assert len(times) == 3
    client.close()
