"""What is kept for a while only: answers of idempotency keys, and uploads in parts that nobody goes
on with."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

from trueup_service.actor_context import time_text
from trueup_service.partial_uploads import PartialUploads
from trueup_service.registry.transaction import reading, writing
from trueup_service.wiring import Parts

INTERVAL_S = 60.0  # an age is hours: it matters little if something stays a minute longer


def remove_expired(parts: Parts, now: datetime | None = None) -> None:
    """Let go of what has reached its age, and of each token's oldest answers beyond those that are
    kept."""
    settings = parts.settings
    before = time_text((now or datetime.now(UTC)) - timedelta(seconds=settings.answers_kept_s))
    with reading(parts.database) as tx:
        answers = tx.idempotency.expired(before, settings.answers_kept)
    if answers:
        with writing(parts.database) as tx:
            tx.idempotency.forget(answers)
    PartialUploads(settings.data_dir).remove_old(settings.uploads_kept_s, dry_run=False)
