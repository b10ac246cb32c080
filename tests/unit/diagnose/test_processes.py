"""Tasks that forked processes solve have the answers that threads give, whatever becomes of the
processes."""

import os
import signal
import subprocess
import sys
import time
from dataclasses import dataclass

import pytest

from tests.support.simulated import recorded_twice
from trueup import cores
from trueup.diagnose.diagnosis import diagnose
from trueup.diagnose.processes import in_processes
from trueup.diagnose.tasks import in_threads

PARENT = os.getpid()


@pytest.fixture(autouse=True)
def two_cores(monkeypatch):
    monkeypatch.setattr("trueup.cores.own_cores", lambda: [0, 1])
    monkeypatch.setattr("trueup.cores._at_most", [])
    cores.cores.cache_clear()
    yield
    cores.cores.cache_clear()


@dataclass
class Squared:
    number: int

    def done(self, problem):
        return self.number**2 + problem, os.getpid()


@dataclass
class Fatal:
    number: int

    def done(self, problem):
        if os.getpid() != PARENT:
            os.kill(os.getpid(), signal.SIGKILL)  # as where memory runs out
        return self.number


@dataclass
class Refusing:
    def done(self, problem):
        raise ValueError("it has no answer")


def test_answers_come_in_order_and_not_from_this_process():
    shares = []
    answers = in_processes(7, [Squared(n) for n in range(9)], shares.append)
    assert [answer for answer, _ in answers] == [n**2 + 7 for n in range(9)]
    assert PARENT not in {pid for _, pid in answers}
    assert shares == pytest.approx([(n + 1) / 9 for n in range(9)])


@pytest.mark.parametrize("count", [0, 1])
def test_nothing_is_forked_for_no_task_or_one(count):
    answers = in_processes(7, [Squared(n) for n in range(count)], lambda _: None)
    assert answers == [(7, PARENT)] * count


def test_where_a_process_dies_threads_solve_the_tasks():
    assert in_processes(0, [Fatal(n) for n in range(4)], lambda _: None) == [0, 1, 2, 3]


def test_what_a_task_raises_is_raised_and_what_a_caller_raises_ends_it():
    with pytest.raises(ValueError, match="it has no answer"):
        in_processes(0, [Refusing(), Refusing()], lambda _: None)

    def cancelled(_share):
        raise InterruptedError

    with pytest.raises(InterruptedError):
        in_processes(0, [Squared(n) for n in range(4)], cancelled)
    assert in_processes(1, [Squared(2), Squared(3)], lambda _: None)[0][0] == 5


SLEEPING = """
import os, time
from trueup import cores
cores.own_cores = lambda: [0, 1]
from trueup.diagnose.processes import in_processes
class Sleep:
    def done(self, problem):
        os.write(1, b"%d\\n" % os.getpid())  # at once: two write side by side
        time.sleep(60)
in_processes(None, [Sleep(), Sleep()], lambda _: None)
"""


def test_processes_end_with_the_one_that_they_were_forked_from():
    with subprocess.Popen([sys.executable, "-c", SLEEPING], stdout=subprocess.PIPE) as parent:
        forked = [int(parent.stdout.readline()) for _ in range(2)]
        parent.kill()
    until = time.monotonic() + 10
    while any(is_alive(pid) for pid in forked):
        assert time.monotonic() < until
        time.sleep(0.01)


def is_alive(pid):
    try:
        with open(f"/proc/{pid}/stat") as stat:
            return stat.read().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


@pytest.mark.slow
def test_a_diagnosis_is_the_same_whoever_solves_it():
    plant, episodes, _ = recorded_twice("A1", ["quadratic_drag"], 21)
    by_threads, by_processes = (
        diagnose(plant, episodes, solve=solve).document for solve in (in_threads, in_processes)
    )
    assert by_processes == by_threads
