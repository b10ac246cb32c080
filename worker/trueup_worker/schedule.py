"""The schedule: it submits the validations that are due, without any alarm."""

from __future__ import annotations

import logging
import threading
import uuid
from datetime import UTC, datetime, timedelta

from trueup.errors import TrueupError
from trueup.gate.policy import UpdatePolicy
from trueup_service.actions.submission import Submission
from trueup_service.actions.submit_job import submit_validation
from trueup_service.actor_context import ActorContext, time_text
from trueup_service.registry.transaction import reading, writing
from trueup_service.wiring import Parts

log = logging.getLogger("trueup.worker")
SCHEDULE = "schedule"  # the actor of the jobs that it submits


def run_schedule(parts: Parts, interval_s: float, stop: threading.Event) -> None:
    """Submits what is due, every `interval_s` [s] until `stop` is set."""
    while not stop.wait(interval_s):
        try:
            submit_due(parts, datetime.now(UTC))
        except Exception:
            log.exception("the schedule could not be looked at")


def submit_due(parts: Parts, now: datetime) -> list[str]:
    """Submits a validation of every plant whose policy asks for one by now.

    Returns the plants' names.
    """
    with reading(parts.database) as tx:
        policies = [
            (p.plant, UpdatePolicy.from_document(p.document)) for p in tx.policies.all_in_force()
        ]
    due = [
        (plant, policy.validate_every_h)
        for plant, policy in policies
        if policy.validate_every_h is not None
    ]
    return [plant for plant, every_h in due if _try_submit(parts, plant, every_h, now)]


def _try_submit(parts: Parts, plant: str, every_h: float, now: datetime) -> bool:
    """Returns whether a validation was submitted. An error of one plant is logged only."""
    try:
        return _submit_if_due(parts, plant, every_h, now)
    except Exception:
        log.exception("a validation that may be due could not be submitted", extra={"plant": plant})
        return False


def _submit_if_due(parts: Parts, plant: str, every_h: float, now: datetime) -> bool:
    context = ActorContext(SCHEDULE, time_text(now))
    with writing(parts.database) as tx:
        tx.plants.lock(plant)  # another worker may look at the same time
        last = tx.jobs.last(plant, "validate")
        if last is not None and last.created_at > time_text(now - timedelta(hours=every_h)):
            return False
        try:
            submit_validation(Submission(tx, parts.queue, uuid.uuid4().hex, plant, {}, context))
        except TrueupError:
            return False  # nothing was held out since then
        return True
