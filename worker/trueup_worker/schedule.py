"""The schedule: validations that are due, whether anything alarmed or not."""

from __future__ import annotations

import logging
import threading
import uuid
from datetime import UTC, datetime, timedelta

from trueup.errors import TrueupError
from trueup.gate.policy import UpdatePolicy
from trueup_service.actions.submit_job import submit_validation
from trueup_service.actor_context import ActorContext, time_text
from trueup_service.registry.transaction import reading, writing
from trueup_service.wiring import Parts

log = logging.getLogger("trueup.worker")
SCHEDULE = "schedule"  # the actor of what nobody asked for


def keep(parts: Parts, interval_s: float, stop: threading.Event) -> None:
    """Submit what is due, again and again."""
    while not stop.wait(interval_s):
        try:
            submit_due(parts, datetime.now(UTC))
        except Exception:
            log.exception("the schedule could not be looked at")


def submit_due(parts: Parts, now: datetime) -> list[str]:
    """Submit a validation of every plant whose policy wants one by now; their names."""
    with reading(parts.database) as tx:
        held = [
            (p.plant, UpdatePolicy.from_document(p.document)) for p in tx.policies.all_in_force()
        ]
    due = [
        (plant, policy.validate_every_h)
        for plant, policy in held
        if policy.validate_every_h is not None
    ]
    return [plant for plant, every_h in due if _tried(parts, plant, every_h, now)]


def _tried(parts: Parts, plant: str, every_h: float, now: datetime) -> bool:
    """One plant's trouble is no other's."""
    try:
        return _submitted(parts, plant, every_h, now)
    except Exception:
        log.exception("a validation that may be due could not be submitted", extra={"plant": plant})
        return False


def _submitted(parts: Parts, plant: str, every_h: float, now: datetime) -> bool:
    context = ActorContext(SCHEDULE, time_text(now))
    with writing(parts.database) as tx:
        tx.plants.lock(plant)  # another worker may look at the same time
        last = tx.jobs.last(plant, "validate")
        if last is not None and last.created_at > time_text(now - timedelta(hours=every_h)):
            return False
        try:
            submit_validation(tx, parts.queue, uuid.uuid4().hex, plant, {}, context)
        except TrueupError:
            return False  # nothing was held out since: there is nothing to validate on
        return True
