"""Solve the tasks of a search by processes that are forked for them: a diagnosis is as much Python
as compiled code, and Python runs on one core of a process.

A forked process has the problem already, so only answers are sent. It ends with the one that it was
forked from. Where nothing can be forked, or one of them dies, as where memory runs out, threads do
the tasks.
"""

from __future__ import annotations

import ctypes
import multiprocessing
import os
import signal
import sys
import threading
import warnings
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from typing import Any

from trueup import cores
from trueup.diagnose.search_problem import SearchProblem
from trueup.diagnose.tasks import Share, Task, get_ready, in_threads

END_WITH_PARENT = 1  # PR_SET_PDEATHSIG. Source: prctl(2)
# what a process that is forked now is forked for
_shared: list[tuple[SearchProblem, Sequence[Task]]] = []
_one_at_a_time = threading.Lock()


def in_processes(problem: SearchProblem, tasks: Sequence[Task], report: Share) -> list[Any]:
    """Solve tasks by forked processes, one for each core."""
    count = min(cores.cores(), len(tasks))
    if count == 1 or not sys.platform.startswith("linux"):
        return in_threads(problem, tasks, report)
    get_ready(problem, tasks)
    try:
        with _one_at_a_time:
            return _forked(problem, tasks, report, count)
    except BrokenProcessPool:
        return in_threads(problem, tasks, report)


def _forked(problem: SearchProblem, tasks: Sequence[Task], report: Share, count: int) -> list[Any]:
    answers: list[Any] = []
    _shared.append((problem, tasks))
    pool = ProcessPoolExecutor(count, multiprocessing.get_context("fork"), _begin, (os.getpid(),))
    try:
        with warnings.catch_warnings():
            # other threads hold no lock that a task takes
            warnings.filterwarnings("ignore", "This process .* is multi-threaded")
            answered = pool.map(_solve, range(len(tasks)))
        for answer in answered:
            answers.append(answer)
            report(len(answers) / len(tasks))
    finally:
        _shared.clear()
        pool.shutdown(wait=True, cancel_futures=True)
    return answers


def _begin(parent: int) -> None:
    """In a forked process: end with the one it was forked from, and use one core alone."""
    ctypes.CDLL(None).prctl(END_WITH_PARENT, signal.SIGKILL)
    if os.getppid() != parent:
        os._exit(1)  # it has ended before that was said
    cores.only_one()


def _solve(number: int) -> Any:
    problem, tasks = _shared[0]
    return tasks[number].done(problem)
