"""A job's progress, written down now and then; where cancellation is noticed."""

from __future__ import annotations

import time
from datetime import UTC, datetime

from trueup.errors import TrueupError
from trueup_service.actor_context import time_text
from trueup_service.registry.records import JobRecord, JobState
from trueup_service.registry.transaction import writing
from trueup_service.wiring import Parts

WRITE_INTERVAL_S = 0.2  # often enough to watch, seldom enough not to matter to other writers


class Cancelled(TrueupError):
    """The job was cancelled."""

    code = "cancelled"
    hint = "Submit it again if it is still wanted."


class Progress:
    """Call it with the share done, 0 to 1, of the present stage. Raises Cancelled."""

    def __init__(self, parts: Parts, job: JobRecord) -> None:
        self._parts, self._job = parts, job
        self._stage, self._begin, self._end = "running", 0.0, 1.0
        self._written = 0.0

    def stage(self, name: str, begin: float, end: float) -> Progress:
        """From now on the job is in this stage, which takes it from one share to another; told
        again, nothing changes."""
        if (name, begin, end) == (self._stage, self._begin, self._end):
            return self
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
            found = tx.jobs.get(self._job.id)
        if found is None or found.state in (JobState.CANCELLING, JobState.CANCELLED):
            raise Cancelled
