"""Fan out: a diagnosis asks workers that have nothing else to do for help with its tasks, and does
itself what nobody took.

- A parcel of tasks is named by its content, so that asking twice is asking once.
- What a helper answers is what we would have found: it declines where its code or processor is
  another.
- Nobody is waited for in vain: what a helper took and does not bring back is done here.
- While nobody helps, one parcel is all that is offered, so that asking costs nothing worth a name.
"""

from __future__ import annotations

import logging
import threading
import time
import zlib
from collections import deque
from collections.abc import Sequence
from types import TracebackType
from typing import Any

from trueup.canonical import digest_of_bytes
from trueup.cores import cores
from trueup.diagnose.search_problem import SearchProblem
from trueup.diagnose.task_batch import pack_tasks, unpack_answers
from trueup.diagnose.tasks import Share, Task, get_ready
from trueup_service.jobs import Helped, JobQueue
from trueup_worker.likeness import likeness

log = logging.getLogger("trueup.worker")

MOST_PARCELS = 12  # of one step of a search
LOOK_S = 0.05  # between looks at what others did
PATIENCE_S, PATIENCE = (
    2.0,
    3.0,
)  # a helper may take so long at least, and so many times what our own longest parcel took
PREFIX = "help."  # of a parcel's name; the job's id and the parcel's digest follow


class FanOut:
    """Solves the tasks of one job's diagnosis. Use it as a context: at its end nothing is left of
    what was asked."""

    def __init__(self, queue: JobQueue, job: str) -> None:
        self._queue, self._job = queue, job
        self._is_helped = True  # until nobody was there

    def __enter__(self) -> FanOut:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._queue.forget(f"{PREFIX}{self._job}.")

    def __call__(self, problem: SearchProblem, tasks: Sequence[Task], told: Share) -> list[Any]:
        """What each task answers, in order. Raises what `told` raises, and then does no more."""
        get_ready(problem, tasks)
        size = max(cores(), -(-len(tasks) // MOST_PARCELS))
        parcels = [range(i, min(i + size, len(tasks))) for i in range(0, len(tasks), size)]
        offered = parcels[1:] if self._is_helped else parcels[1:][-1:]
        named = {
            self._name(text): (part, text)
            for part, text in ((p, pack_tasks(problem, [tasks[i] for i in p])) for p in offered)
        }
        self._queue.ask_for_help(
            self._job, {name: f"{likeness()} {text}" for name, (_, text) in reversed(named.items())}
        )
        step = _Step(problem, tasks, [i for p in parcels if p not in offered for i in p])
        asked = _Asked(self._queue, {name: part for name, (part, _) in named.items()})
        try:
            while step.missing:
                step.wait(LOOK_S)
                asked.look(step)
                told(1.0 - len(step.missing) / len(tasks))
        finally:
            step.end()
            asked.end()
        if named:
            self._is_helped = asked.was_heard
        return step.answers

    def _name(self, parcel: str) -> str:
        return f"{PREFIX}{self._job}.{digest_of_bytes(parcel.encode())}"


class _Step:
    """The tasks of one step, some of them in the hands of our own threads."""

    def __init__(self, problem: SearchProblem, tasks: Sequence[Task], ours: Sequence[int]) -> None:
        self._problem, self._tasks = problem, tasks
        self._ours, self._changed = deque(ours), threading.Condition()
        self._running, self._ends = 0, False
        self._failed: BaseException | None = None
        self.answers: list[Any] = [None] * len(tasks)
        self.missing = set(range(len(tasks)))
        self.longest_s = 0.0
        self._threads = [
            threading.Thread(target=self._work, daemon=True)
            for _ in range(min(cores(), len(tasks)))
        ]
        for thread in self._threads:
            thread.start()

    @property
    def has_idle_hands(self) -> bool:
        """Whether one of our threads has nothing to do."""
        with self._changed:
            return not self._ours and self._running < len(self._threads)

    def take(self, part: Sequence[int]) -> None:
        """Do what is missing of a part ourselves."""
        with self._changed:
            self._ours.extend(i for i in part if i in self.missing and i not in self._ours)
            self._changed.notify_all()

    def bring(self, part: Sequence[int], answers: Sequence[Any]) -> None:
        """What somebody else answered."""
        for i, answer in zip(part, answers, strict=True):
            self._keep(i, answer)

    def wait(self, longest_s: float) -> None:
        """Until something is answered, or so long [s]. Raises what a task raised."""
        with self._changed:
            if self.missing and self._failed is None:
                self._changed.wait(longest_s)
            if self._failed is not None:
                raise self._failed

    def end(self) -> None:
        """Begin nothing more, and wait for what was begun."""
        with self._changed:
            self._ends = True
            self._changed.notify_all()
        for thread in self._threads:
            thread.join()

    def _work(self) -> None:
        while (i := self._next()) is not None:
            began = time.monotonic()
            try:
                self._keep(i, self._tasks[i].done(self._problem))
            except BaseException as error:  # noqa: BLE001  (it is raised where the step is waited for)
                with self._changed:
                    self._failed = error
            with self._changed:
                self._running -= 1
                self.longest_s = max(self.longest_s, time.monotonic() - began)
                self._changed.notify_all()

    def _next(self) -> int | None:
        with self._changed:
            while not self._ends:
                if self._ours:
                    self._running += 1
                    i = self._ours.popleft()
                    if i in self.missing:
                        return i
                    self._running -= 1
                else:
                    self._changed.wait()
            return None

    def _keep(self, i: int, answer: Any) -> None:
        with self._changed:
            if i in self.missing:  # else somebody was quicker, with the same answer
                self.answers[i] = answer
                self.missing.discard(i)
                self._changed.notify_all()


class _Asked:
    """What others were asked for in one step."""

    def __init__(self, queue: JobQueue, parts: dict[str, Sequence[int]]) -> None:
        self._queue, self._parts = queue, parts
        self._taken: dict[str, float] = {}  # when a helper was first seen at it
        self.was_heard = False

    def look(self, step: _Step) -> None:
        """Gather what was done, and give our own idle hands the first part that nobody has, or that
        was taken too long ago."""
        if not self._parts:
            return
        now, waiting, late = time.monotonic(), [], []
        states = self._queue.help(list(self._parts))
        for name, part in list(self._parts.items()):
            helped = states.get(name)
            if helped is None or helped.state is Helped.FAILED:
                step.take(self._parts.pop(name))
            elif helped.state is Helped.DONE:
                answers = _answers(helped.answer, len(part))
                self.was_heard = self.was_heard or bool(answers)
                step.bring(part[: len(answers)], answers)
                step.take(self._parts.pop(name))
            elif helped.state is Helped.WAITING:
                waiting.append(name)
            else:
                self.was_heard = True
                if now - self._taken.setdefault(name, now) > max(
                    PATIENCE_S, PATIENCE * step.longest_s * len(part)
                ):
                    late.append(name)
        if step.has_idle_hands and (waiting or late):
            name = [*waiting, *late][0]
            self._queue.withdraw([name] if waiting else [])
            step.take(self._parts.pop(name))

    def end(self) -> None:
        """Take back what is left."""
        self._queue.withdraw(list(self._parts))


def _answers(text: str | None, many: int) -> list[Any]:
    """What a helper answered; nothing where it declined, or where that cannot be read."""
    if not text:
        return []
    try:
        answers = unpack_answers(text)
    except (ValueError, LookupError, TypeError, zlib.error):
        log.exception("what a helper answered cannot be read")
        return []
    return answers if len(answers) == many else []
