"""Help with somebody else's diagnosis: the tasks of one parcel, from the same episodes."""

from __future__ import annotations

import logging
import threading

from trueup.diagnose.task_worker import TaskWorker
from trueup.episode.role import Role
from trueup_service.actions import find
from trueup_service.registry.records import FINAL
from trueup_service.registry.transaction import reading
from trueup_service.wiring import Parts
from trueup_worker.inputs import read_episodes, read_plant
from trueup_worker.likeness import likeness

log = logging.getLogger("trueup.worker")
DECLINED = ""


class Helping:
    """Answers parcels, and remembers the diagnosis that it helped with last."""

    def __init__(self, parts: Parts) -> None:
        self._parts = parts
        self._lock = threading.Lock()
        self._known: tuple[str, TaskWorker] | None = None

    def answer(self, job: str, parcel: str) -> str:
        """What the tasks of a parcel answer; DECLINED where whoever asked has to do them: it would,
        if we had died."""
        like, _, text = parcel.partition(" ")
        if like != likeness():
            log.info("declined to help a worker that computes otherwise", extra={"job": job})
            return DECLINED
        try:
            with self._lock:
                helper = self._helper(job)
            if helper is None:
                return DECLINED
            answer = helper.answer(text)
            log.info("helped", extra={"job": job})
            return answer
        except Exception:
            log.exception("could not help", extra={"job": job})
            return DECLINED

    def _helper(self, job: str) -> TaskWorker | None:
        """None of a job that is over."""
        with reading(self._parts.database) as tx:
            found = find.job(tx, job)
        if found.state in FINAL:
            return None
        if self._known is None or self._known[0] != job:
            plant = read_plant(self._parts, found)
            episodes = read_episodes(
                self._parts, found, plant, (Role.ADAPTATION, Role.VALIDATION), lambda _: None
            )
            self._known = job, TaskWorker(plant, episodes)
        return self._known[1]
