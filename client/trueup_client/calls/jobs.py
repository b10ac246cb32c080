"""Calls on jobs: what the workers compute."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Iterator

from trueup_client.problem import DigestMismatch, Problem
from trueup_client.records import Document, Job, JobWithReads, QueuedJob
from trueup_client.transport import Transport, url_path

FINAL_STATES = ("succeeded", "failed", "cancelled")
POLL_S = 0.1


class JobCalls(Transport):
    """Jobs."""

    def submit(self, plant: str, request: Document, key: str | None = None) -> Job:
        """Submits a job, such as {"kind": "fit", "method": "identify"}.

        A trial is {"kind": "gate", "candidate": …, "gate": …}. The same request under the same
        `key` is the same job, also from another process, for as long as the service remembers keys.
        """
        return self._post(url_path("plants", plant, "jobs"), request, key)

    def jobs(self, plant: str) -> Iterator[Job]:
        """Yields the jobs of a plant, the newest first."""
        return self._pages(url_path("plants", plant, "jobs"), "before")

    def queue(self) -> Iterator[QueuedJob]:
        """Yields the jobs of all plants that have not ended, the oldest first."""
        return self._pages(url_path("jobs"), "after")

    def job(self, job: str) -> JobWithReads:
        """Returns a job as it is now, with the digests of what it has read, and its outputs."""
        return self._get(url_path("jobs", job))

    def wait(
        self, job: str, progress: Callable[[JobWithReads], None] = lambda _: None
    ) -> JobWithReads:
        """Waits until a job has succeeded, and returns it; calls `progress` with each look at it.

        Raises Problem if the job failed or was cancelled.
        """
        while True:
            current = self.job(job)
            progress(current)
            if current["state"] in FINAL_STATES:
                break
            time.sleep(POLL_S)
        state, result = current["state"], current["result"]
        if state == "succeeded":
            return current
        if result and "problem" in result:
            raise Problem(0, result["problem"])
        raise Problem(0, {"code": state, "detail": f"job {job} was {state}"})

    def output(self, job: str, name: str) -> bytes:
        """Returns a file that a job left behind. Raises KeyError where the job left none of that
        name, DigestMismatch if the bytes are not what the job says they are."""
        digest = {o["name"]: o["digest"] for o in self.job(job)["outputs"]}[name]
        content = self._connection.whole(
            "GET", url_path("jobs", job, "outputs", name), lambda: None
        )
        if hashlib.sha256(content).hexdigest() != digest:
            raise DigestMismatch(f"the file {name} of job {job} is not what the job left behind")
        return content

    def cancel(self, job: str) -> Job:
        """Cancels a job: at once if it waits, at its next report of progress if it runs."""
        return self._post(url_path("jobs", job, "cancel"), None)
