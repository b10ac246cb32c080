"""Spread: parts of a job become entries of the job engine, which any worker with a core to spare
takes.

A part is named by what is asked, so that a job that is begun again finds the answers it had. A part
whose worker dies is resumed like a job. The job that waits for parts runs beside them: its own
worker takes some too, so that one worker is enough.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from types import TracebackType
from typing import Any

from trueup.canonical import Json, digest_of
from trueup.errors import TrueupError
from trueup_service.jobs import PART_PREFIX, JobQueue, PartState

POLL_S = 0.2  # between looks at the parts; each takes seconds
ATTEMPTS = 5  # at a part that the engine gave up on


class PartFailed(TrueupError):
    """A part of a job failed; its code and hint are those of the part's problem."""

    code = "part-failed"
    hint = "Read the problem; then submit the job again."

    def __init__(self, problem: Mapping[str, Any]) -> None:
        super().__init__(problem["detail"], hint=problem["hint"], **problem["facts"])
        self.code = problem["code"]


class Spread:
    """Has the parts of one job computed by all workers. Use it as a context: at its end no part
    is left."""

    def __init__(self, queue: JobQueue, job: str) -> None:
        self._queue, self._job = queue, job
        self._prefix = f"{PART_PREFIX}{job}."

    def __enter__(self) -> Spread:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._queue.remove(self._queue.names(self._prefix))

    def __call__(
        self, asked: Sequence[Mapping[str, Any]], progress: Callable[[float], None]
    ) -> Iterator[Any]:
        """Yields the answers of `part` of the job's kind to each of these, in their order.

        Calls `progress` with the share that was yielded while it waits, and ends with what that
        raises. Raises PartFailed.
        """
        names = [f"{self._prefix}{digest_of(one)}" for one in asked]
        named = dict(zip(names, asked, strict=True))
        # of an attempt before this one that asked otherwise
        self._queue.remove([n for n in self._queue.names(self._prefix) if n not in named])
        answers: dict[str, Any] = {}
        tries = Counter[str]()
        for count, name in enumerate(names):
            while name not in answers:
                self._look([n for n in named if n not in answers], named, answers, tries)
                progress(count / len(names))
                if name not in answers:
                    time.sleep(POLL_S)
            yield answers[name]

    def _look(
        self,
        missing: Sequence[str],
        named: Mapping[str, Json],
        answers: dict[str, Any],
        tries: Counter[str],
    ) -> None:
        """Queues parts that are missing, and collects the answers that are there."""
        parts = self._queue.parts(missing)
        self._queue.spread(self._job, {n: named[n] for n in missing if n not in parts})
        for name, part in parts.items():
            if part.state is PartState.DONE:
                answers[name] = _answer(part.answer)
            elif part.state is PartState.FAILED:
                tries[name] += 1
                if tries[name] > ATTEMPTS:
                    raise PartFailed(_GIVEN_UP)
                self._queue.resume(name)


_GIVEN_UP = {
    "code": "given-up",
    "detail": f"the job engine gave up a part of the job {ATTEMPTS} times",
    "hint": "Read the worker's log, then submit the job again.",
    "facts": {},
}


def _answer(answer: Mapping[str, Any]) -> Any:
    if "problem" in answer:
        raise PartFailed(answer["problem"])
    return answer["answer"]
