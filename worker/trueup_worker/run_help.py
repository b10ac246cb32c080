"""Help with another worker's diagnosis: solve one batch of its tasks from the same episodes."""

from __future__ import annotations

import logging
import threading

from trueup.diagnose.task_worker import TaskWorker
from trueup.episode.role import Role
from trueup_service.actions import find
from trueup_service.registry.records import FINAL
from trueup_service.registry.transaction import reading
from trueup_service.wiring import Parts
from trueup_worker.compute_fingerprint import compute_fingerprint
from trueup_worker.inputs import read_episodes, read_plant

log = logging.getLogger("trueup.worker")
DECLINED = ""


class Helping:
    """Answers batches of tasks, and remembers the diagnosis that it helped with last."""

    def __init__(self, parts: Parts) -> None:
        self._parts = parts
        self._lock = threading.Lock()
        self._last: tuple[str, TaskWorker] | None = None

    def answer(self, job: str, offer: str) -> str:
        """Returns the packed answers of a batch, offered as fingerprint and text.

        Returns DECLINED if it cannot answer. The worker that offered the batch then solves it, as
        it would if this worker had died.
        """
        fingerprint, _, batch = offer.partition(" ")
        if fingerprint != compute_fingerprint():
            log.info("declined to help a worker that computes otherwise", extra={"job": job})
            return DECLINED
        try:
            with self._lock:
                helper = self._helper(job)
            if helper is None:
                return DECLINED
            answer = helper.answer(batch)
            log.info("helped", extra={"job": job})
            return answer
        except Exception:
            log.exception("could not help", extra={"job": job})
            return DECLINED

    def _helper(self, job_id: str) -> TaskWorker | None:
        """Returns the helper of a job's diagnosis; None if the job is over."""
        with reading(self._parts.database) as tx:
            job = find.job(tx, job_id)
        if job.state in FINAL:
            return None
        if self._last is None or self._last[0] != job_id:
            plant = read_plant(self._parts, job)
            roles = Role.ADAPTATION, Role.VALIDATION
            episodes = read_episodes(self._parts, job, plant, roles, lambda _: None)
            self._last = job_id, TaskWorker(plant, episodes)
        return self._last[1]
