"""The calls of trueup_client.calls.jobs for an event loop.

Made by tools/make_async_client.py.
"""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable

from trueup_client.calls.jobs import JobCalls
from trueup_client.pool import Pooled
from trueup_client.records import Document, Job, JobWithReads, QueuedJob


class AsyncJobCalls(Pooled):
    """Jobs. For an event loop."""

    async def submit(self, plant: str, request: Document, key: str | None = None) -> Job:
        """Submits a job, such as {"kind": "fit", "method": "identify"}.

        A trial is {"kind": "gate", "candidate": …, "gate": …}. The same request under the same
        `key` is the same job, also from another process, for as long as the service remembers keys.
        """
        return await self._pool.run(JobCalls.submit, plant, request, key)

    def jobs(self, plant: str) -> AsyncIterator[Job]:
        """Yields the jobs of a plant, the newest first."""
        return self._pool.each(JobCalls.jobs, plant)

    def queue(self) -> AsyncIterator[QueuedJob]:
        """Yields the jobs of all plants that have not ended, the oldest first."""
        return self._pool.each(JobCalls.queue)

    async def job(self, job: str) -> JobWithReads:
        """Returns a job as it is now, with the digests of what it has read, and its outputs."""
        return await self._pool.run(JobCalls.job, job)

    async def wait(
        self, job: str, progress: Callable[[JobWithReads], None] = lambda _: None
    ) -> JobWithReads:
        """Waits until a job has succeeded, and returns it; calls `progress` with each look at it.

        Raises Problem if the job failed or was cancelled.
        """
        return await self._pool.run(JobCalls.wait, job, progress)

    async def output(self, job: str, name: str) -> bytes:
        """Returns a file that a job left behind. Raises KeyError where the job left none of that
        name, DigestMismatch if the bytes are not what the job says they are."""
        return await self._pool.run(JobCalls.output, job, name)

    async def cancel(self, job: str) -> Job:
        """Cancels a job: at once if it waits, at its next report of progress if it runs."""
        return await self._pool.run(JobCalls.cancel, job)
