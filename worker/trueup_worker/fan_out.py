"""Fan out: a diagnosis offers its tasks to idle workers, and solves itself what nobody takes.

- A batch of tasks is named by its content, so offering it twice is offering it once.
- A helper answers with the bits that this worker would compute; it declines if its compute
  fingerprint is another.
- A batch that a helper took and does not return in time is solved here.
- While nobody helps, only one batch of each step is offered, so that offering costs little.
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
from trueup_worker.compute_fingerprint import compute_fingerprint

log = logging.getLogger("trueup.worker")

MOST_BATCHES = 12  # of one step of a search
POLL_S = 0.05  # between looks at the offered batches
# a helper may take PATIENCE times as long as our longest task takes for each of its tasks, and at
# least PATIENCE_S [s]
PATIENCE_S, PATIENCE = 2.0, 3.0
PREFIX = "help."  # of a batch's name; the job's id and the batch's digest follow


class FanOut:
    """Solves the tasks of one job's diagnosis, with the help of idle workers.

    Use it as a context: at its end every offered batch is removed.
    """

    def __init__(self, queue: JobQueue, job: str) -> None:
        self._queue, self._job = queue, job
        self._is_helped = True  # until nobody took a batch

    def __enter__(self) -> FanOut:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._queue.forget(f"{PREFIX}{self._job}.")

    def __call__(self, problem: SearchProblem, tasks: Sequence[Task], progress: Share) -> list[Any]:
        """Returns the answers of the tasks, in order.

        Calls `progress` with the share that is done, and ends with what it raises.
        """
        get_ready(problem, tasks)
        size = max(cores(), -(-len(tasks) // MOST_BATCHES))
        batches = [range(i, min(i + size, len(tasks))) for i in range(0, len(tasks), size)]
        offered = batches[1:] if self._is_helped else batches[1:][-1:]
        packed = [(batch, pack_tasks(problem, [tasks[i] for i in batch])) for batch in offered]
        named = {self._name(text): (batch, text) for batch, text in packed}
        fingerprint = compute_fingerprint()
        self._queue.ask_for_help(
            self._job,
            {name: f"{fingerprint} {text}" for name, (_, text) in reversed(named.items())},
        )
        ours = [i for batch in batches if batch not in offered for i in batch]
        step = _Step(problem, tasks, ours)
        offers = _Offers(self._queue, {name: batch for name, (batch, _) in named.items()})
        try:
            while step.missing:
                step.wait(POLL_S)
                offers.collect(step)
                progress(1.0 - len(step.missing) / len(tasks))
        finally:
            step.end()
            offers.withdraw()
        if named:
            self._is_helped = offers.were_taken
        return step.answers

    def _name(self, packed: str) -> str:
        return f"{PREFIX}{self._job}.{digest_of_bytes(packed.encode())}"


class _Step:
    """The tasks of one step, some of which threads of this process solve."""

    def __init__(self, problem: SearchProblem, tasks: Sequence[Task], ours: Sequence[int]) -> None:
        self._problem, self._tasks = problem, tasks
        self._ours, self._changed = deque(ours), threading.Condition()
        self._running, self._ends = 0, False
        self._failure: BaseException | None = None
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
    def has_idle_thread(self) -> bool:
        """Whether one of our threads has nothing to do."""
        with self._changed:
            return not self._ours and self._running < len(self._threads)

    def solve(self, batch: Sequence[int]) -> None:
        """Has our threads solve what is missing of a batch."""
        with self._changed:
            self._ours.extend(i for i in batch if i in self.missing and i not in self._ours)
            self._changed.notify_all()

    def accept(self, batch: Sequence[int], answers: Sequence[Any]) -> None:
        """Records the answers of a helper."""
        for i, answer in zip(batch, answers, strict=True):
            self._record(i, answer)

    def wait(self, longest_s: float) -> None:
        """Waits until a task is answered, but at most so long [s]. Raises what a task raised."""
        with self._changed:
            if self.missing and self._failure is None:
                self._changed.wait(longest_s)
            if self._failure is not None:
                raise self._failure

    def end(self) -> None:
        """Begins no more tasks, and waits for those that run."""
        with self._changed:
            self._ends = True
            self._changed.notify_all()
        for thread in self._threads:
            thread.join()

    def _work(self) -> None:
        while (i := self._next()) is not None:
            began = time.monotonic()
            try:
                self._record(i, self._tasks[i].done(self._problem))
            except BaseException as error:  # noqa: BLE001  (`wait` raises it)
                with self._changed:
                    self._failure = error
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

    def _record(self, i: int, answer: Any) -> None:
        with self._changed:
            if i in self.missing:  # else somebody was quicker, with the same answer
                self.answers[i] = answer
                self.missing.discard(i)
                self._changed.notify_all()


class _Offers:
    """The batches of one step that were offered to helpers, by name."""

    def __init__(self, queue: JobQueue, batches: dict[str, Sequence[int]]) -> None:
        self._queue, self._batches = queue, batches
        self._taken: dict[str, float] = {}  # when a helper was first seen at a batch
        self.were_taken = False

    def collect(self, step: _Step) -> None:
        """Collects the answers, and gives one batch to an idle thread of our own.

        That batch is the first that nobody has taken, or else one that is overdue.
        """
        if not self._batches:
            return
        now, waiting, overdue = time.monotonic(), [], []
        states = self._queue.help(list(self._batches))
        for name, batch in list(self._batches.items()):
            help_ = states.get(name)
            if help_ is None or help_.state is Helped.FAILED:
                step.solve(self._batches.pop(name))
            elif help_.state is Helped.DONE:
                answers = _unpacked(help_.answer, len(batch))
                self.were_taken = self.were_taken or bool(answers)
                step.accept(batch[: len(answers)], answers)
                step.solve(self._batches.pop(name))
            elif help_.state is Helped.WAITING:
                waiting.append(name)
            else:
                self.were_taken = True
                limit_s = max(PATIENCE_S, PATIENCE * step.longest_s * len(batch))
                if now - self._taken.setdefault(name, now) > limit_s:
                    overdue.append(name)
        if step.has_idle_thread and (waiting or overdue):
            name = [*waiting, *overdue][0]
            self._queue.withdraw([name] if waiting else [])
            step.solve(self._batches.pop(name))

    def withdraw(self) -> None:
        """Withdraws the batches that are left."""
        self._queue.withdraw(list(self._batches))


def _unpacked(text: str | None, count: int) -> list[Any]:
    """Returns a helper's answers; none if it declined, or if they cannot be read."""
    if not text:
        return []
    try:
        answers = unpack_answers(text)
    except (ValueError, LookupError, TypeError, zlib.error):
        log.exception("what a helper answered cannot be read")
        return []
    return answers if len(answers) == count else []
