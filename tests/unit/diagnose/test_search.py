"""The search: what is known after it does not depend on which thread was faster."""

from dataclasses import dataclass, replace
from threading import Event

import numpy as np
import pytest

import trueup.cores
from trueup.diagnose.candidate import Candidate
from trueup.diagnose.search import Search
from trueup.fit.rollout_fit import RolloutFit
from trueup.model.hypothesis import Hypothesis

SHARED = Hypothesis() | "coulomb_friction"
# from where the shared part is fitted at a cost of 8, and of 9
CHEAP, DEAR = SHARED | "backlash", SHARED | "cogging"


def fit(hypothesis, cost):
    none = np.zeros(0)
    return RolloutFit(
        hypothesis, none, none, {}, cost, none, 1, np.zeros((0, 0)), True, np.zeros((0, 0))
    )


@dataclass
class Fits:
    """A problem whose fits cost what the test says; one of them is told of only once the other
    candidate is done."""

    slow: float
    done: Event
    adaptation: tuple = ()

    @property
    def fitter(self):
        return self

    @property
    def fits(self):
        return self

    def fit(self, _, hypothesis, values, *__, **___):
        return fit(hypothesis, float(values[0]) if hypothesis == SHARED else 5.0)

    def without(self, values, _):
        return values

    def candidate(self, fitted, *_):
        if fitted.cost == self.slow:
            assert self.done.wait(60.0)
        return Candidate(fitted, fitted)


@pytest.mark.parametrize("slow", [8.0, 9.0])
def test_the_cheaper_fit_of_a_part_is_kept_whichever_thread_is_faster(slow, monkeypatch):
    monkeypatch.setattr(trueup.cores, "cores", lambda: 2)
    done = Event()
    search = Search(Fits(slow, done))
    pair = [
        Candidate(replace(fit(h, 1.0), values=np.array([cost])), fit(h, 1.0))
        for h, cost in ((CHEAP, 8.0), (DEAR, 9.0))
    ]

    def work(known, candidate):
        known._smaller(candidate)
        if candidate.fit.values[0] != slow:
            done.set()

    search.at_once(work, pair)
    assert search.candidates[SHARED].fit.cost == 8.0
