"""What is stored for a limited time: responses under idempotency keys, and uploads in parts and
drafts of plants that were abandoned."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

from trueup_service.actor_context import time_text
from trueup_service.drafts import Drafts
from trueup_service.partial_uploads import PartialUploads
from trueup_service.registry.transaction import reading, writing
from trueup_service.wiring import Parts

INTERVAL_S = 60.0  # ages are hours, so a minute more does not matter


def remove_expired(parts: Parts, now: datetime | None = None) -> None:
    """Remove what has reached its age, and of each token the oldest responses beyond the number
    that is kept."""
    settings = parts.settings
    before = time_text((now or datetime.now(UTC)) - timedelta(seconds=settings.answers_kept_s))
    with reading(parts.database) as tx:
        answers = tx.idempotency.expired(before, settings.answers_kept)
    if answers:
        with writing(parts.database) as tx:
            tx.idempotency.forget(answers)
    PartialUploads(settings.data_dir).remove_old(settings.uploads_kept_s, dry_run=False)
    Drafts(settings.data_dir).remove_old(settings.uploads_kept_s)
