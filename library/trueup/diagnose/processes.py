"""Solve the tasks of a search by forked processes: more than half of a diagnosis is Python, which
one process runs on one core at a time.

A forked process has the problem already, so only answers are sent. It ends when the process ends
that it was forked from. Off Linux, and where a forked process dies, as when memory runs out,
threads solve the tasks.
"""

from __future__ import annotations

import ctypes
import multiprocessing
import os
import signal
import sys
import warnings
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from typing import Any

from trueup import cores
from trueup.diagnose.search_problem import SearchProblem
from trueup.diagnose.tasks import Share, Task, get_ready, in_threads

END_WITH_PARENT = 1  # PR_SET_PDEATHSIG. Source: prctl(2)
_given: list[tuple[SearchProblem, Sequence[Task]]] = []  # in a forked process, what it is for


def in_processes(problem: SearchProblem, tasks: Sequence[Task], report: Share) -> list[Any]:
    """Solve tasks by forked processes, one for each core."""
    count = min(cores.cores(), len(tasks))
    if count <= 1 or not sys.platform.startswith("linux"):
        return in_threads(problem, tasks, report)
    get_ready(problem, tasks)
    try:
        return _forked(problem, tasks, report, count)
    except BrokenProcessPool:
        return in_threads(problem, tasks, report)


def _forked(problem: SearchProblem, tasks: Sequence[Task], report: Share, count: int) -> list[Any]:
    answers: list[Any] = []
    given = os.getpid(), problem, tasks
    pool = ProcessPoolExecutor(count, multiprocessing.get_context("fork"), _begin, given)
    try:
        with warnings.catch_warnings():
            # of Python 3.12 and later; a task takes no lock that another thread may hold
            warnings.filterwarnings("ignore", "This process .* is multi-threaded")
            answered = pool.map(_solve, range(len(tasks)))
        for answer in answered:
            answers.append(answer)
            report(len(answers) / len(tasks))
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
    return answers


def _begin(parent: int, problem: SearchProblem, tasks: Sequence[Task]) -> None:
    """In a forked process: end with its parent, use one core alone, and know what to solve. Nothing
    is sent for that, since a fork has its parent's memory."""
    ctypes.CDLL(None).prctl(END_WITH_PARENT, signal.SIGKILL)
    if os.getppid() != parent:
        os._exit(1)  # it has ended before that was said
    cores.use_one()
    _given.append((problem, tasks))


def _solve(number: int) -> Any:
    problem, tasks = _given[0]
    return tasks[number].done(problem)
