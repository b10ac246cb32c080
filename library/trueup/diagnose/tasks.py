"""Tasks: parts of a search that depend on its problem and their own arguments alone, so that
whoever has the episodes may do them.

The tasks of one step of a search depend on nothing of each other, and what they answer is the same
whoever does them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trueup.cores import in_parallel
from trueup.diagnose.candidate import Candidate
from trueup.diagnose.search_problem import SearchProblem
from trueup.fit.rollout_fit import RolloutFit


@dataclass(frozen=True, slots=True, eq=False)
class Screen:
    """Short fits of a composition with one term more, of whose initial guesses a linear model
    expects these costs `(guesses,)`."""

    parent: RolloutFit
    term: str
    expected: NDArray[np.float64]

    def done(self, problem: SearchProblem) -> Sequence[RolloutFit]:
        """The fits that go on, the best first."""
        return problem.screen(self.parent, self.term, self.expected)


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """The fit on whole windows of what screened best."""

    parent_cost: float
    term: str
    screened: Sequence[RolloutFit]

    def done(self, problem: SearchProblem) -> Candidate:
        """The composition, checked on validation episodes."""
        return problem.fit(self.parent_cost, self.term, self.screened)


@dataclass(frozen=True, slots=True, eq=False)
class Converge:
    """A composition fitted until nothing moves."""

    candidate: Candidate

    def done(self, problem: SearchProblem) -> Candidate:
        """The composition, no worse than it was."""
        return problem.converge(self.candidate)


Task = Screen | Fit | Converge
Share = Callable[[float], None]
# What each task answers, in order; the share that is done is reported meanwhile.
Solve = Callable[[SearchProblem, Sequence[Task], Share], list[Any]]


def get_ready(problem: SearchProblem, tasks: Sequence[Task]) -> None:
    """Find out once what several threads would ask for at the same time."""
    for task in tasks:
        if isinstance(task, Screen):
            problem.short_fit(task.parent)


def in_threads(problem: SearchProblem, tasks: Sequence[Task], report: Share) -> list[Any]:
    """Solve tasks by threads of this process."""
    get_ready(problem, tasks)
    answers = []
    for answer in in_parallel(lambda task: task.done(problem), tasks):
        answers.append(answer)
        report(len(answers) / len(tasks))
    return answers
