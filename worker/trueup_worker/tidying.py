"""Tidying: what the job engine keeps of jobs that have ended is deleted by age."""

from __future__ import annotations

import logging
import threading
from datetime import UTC, datetime, timedelta

from trueup_service.actor_context import time_text
from trueup_service.registry.transaction import reading, writing
from trueup_service.wiring import Parts

log = logging.getLogger("trueup.worker")

INTERVAL_S = 3600.0  # ages are days, so an hour more does not matter


def run_tidying(parts: Parts, stop: threading.Event) -> None:
    """Tidies once an hour until `stop` is set."""
    while not stop.is_set():
        try:
            purge(parts, datetime.now(UTC))
        except Exception:
            log.exception("old entries of the job engine could not be deleted")
        stop.wait(INTERVAL_S)


def purge(parts: Parts, now: datetime) -> int:
    """Deletes what the engine keeps of jobs that ended longer ago than `jobs_kept_s`, and attempts
    that began before. Returns the number of entries."""
    before = now - timedelta(seconds=parts.settings.jobs_kept_s)
    with reading(parts.database) as tx:
        unfinished = tx.jobs.unfinished()
    count = parts.queue.purge(before, unfinished)
    with writing(parts.database) as tx:
        tx.attempts.forget_before(time_text(before))
    if count:
        log.info("old entries of the job engine were deleted", extra={"entries": count})
    return count
