"""Task: a part of a search that depends on its problem and its own arguments alone, so that whoever
has the episodes may do it.

The tasks of one step of a search depend on nothing of each other, and what they answer is the same
whoever does them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trueup.diagnose.problem import Candidate, Problem
from trueup.fit.rollout_fit import RolloutFit, in_parallel


@dataclass(frozen=True, slots=True, eq=False)
class Race:
    """Short fits of a composition with one term more, of whose starts a linear model expects these
    costs `(starts,)`."""

    parent: RolloutFit
    term: str
    expected: NDArray[np.float64]

    def done(self, problem: Problem) -> Sequence[RolloutFit]:
        """The fits that go on, the best first."""
        return problem.race(self.parent, self.term, self.expected)


@dataclass(frozen=True, slots=True, eq=False)
class Settle:
    """The fit to the end of what did best in a race."""

    parent_cost: float
    term: str
    raced: Sequence[RolloutFit]

    def done(self, problem: Problem) -> Candidate:
        """The composition, checked on validation episodes."""
        return problem.settle(self.parent_cost, self.term, self.raced)


@dataclass(frozen=True, slots=True, eq=False)
class Refine:
    """A composition fitted until nothing moves."""

    candidate: Candidate

    def done(self, problem: Problem) -> Candidate:
        """The same composition, no worse."""
        return problem.refine(self.candidate)


Task = Race | Settle | Refine
Share = Callable[[float], None]
Solve = Callable[
    [Problem, Sequence[Task], Share], list[Any]
]  # what each task answers, in order, while the share done is told


def get_ready(problem: Problem, tasks: Sequence[Task]) -> None:
    """Find out once what several threads would ask for at the same time."""
    for task in tasks:
        if isinstance(task, Race):
            problem.near(task.parent)


def in_threads(problem: Problem, tasks: Sequence[Task], told: Share) -> list[Any]:
    """Solve tasks by threads of this process."""
    get_ready(problem, tasks)
    answers = []
    for answer in in_parallel(lambda task: task.done(problem), tasks):
        answers.append(answer)
        told(len(answers) / len(tasks))
    return answers
