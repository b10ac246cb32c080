"""A job's progress, stored at intervals. Storing it is where a cancellation is noticed."""

from __future__ import annotations

import time
from datetime import UTC, datetime
from types import TracebackType

from trueup.errors import TrueupError
from trueup_service.actor_context import time_text
from trueup_service.open_telemetry import Stages
from trueup_service.registry.records import JobRecord, JobState
from trueup_service.registry.transaction import writing
from trueup_service.wiring import Parts

WRITE_INTERVAL_S = 0.2  # often enough to watch, rare enough not to slow other writers


class Cancelled(TrueupError):
    """The job was cancelled."""

    code = "cancelled"
    hint = "Submit it again if it is still wanted."


class Progress:
    """Called with the share of the present stage that is done, 0 to 1. Raises Cancelled.

    Use it as a context, which ends the span of the last stage where traces are exported.
    """

    def __init__(self, parts: Parts, job: JobRecord) -> None:
        self._parts, self._job = parts, job
        self._stage, self._begin, self._end = "running", 0.0, 1.0
        self._written = 0.0
        self._spans = Stages()

    def __enter__(self) -> Progress:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._spans.end()

    def stage(self, name: str, begin: float, end: float) -> Progress:
        """Enters a stage that covers the job's progress from `begin` to `end`, each 0 to 1.

        Entering the present stage again changes nothing.
        """
        if (name, begin, end) == (self._stage, self._begin, self._end):
            return self
        if name != self._stage:
            self._spans.enter(name)
        self._stage, self._begin, self._end, self._written = name, begin, end, 0.0
        self(0.0)
        return self

    def __call__(self, share: float) -> None:
        if time.monotonic() - self._written < WRITE_INTERVAL_S:
            return
        self._written = time.monotonic()
        done = self._begin + share * (self._end - self._begin)
        with writing(self._parts.database) as tx:
            tx.jobs.update(
                self._job.id, now=time_text(datetime.now(UTC)), progress=done, stage=self._stage
            )
            job = tx.jobs.get(self._job.id)
        if job is None or job.state in (JobState.CANCELLING, JobState.CANCELLED):
            raise Cancelled
