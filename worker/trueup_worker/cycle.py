"""The correction cycle, as the effects of a job continue it."""

from __future__ import annotations

import uuid

from trueup_service.actions.continue_cycle import Cycle
from trueup_service.actor_context import ActorContext
from trueup_service.registry.transaction import Transaction
from trueup_service.wiring import Parts


def cycle_of(parts: Parts, tx: Transaction, context: ActorContext) -> Cycle:
    """Returns the correction cycle within a job's transaction."""
    return Cycle(tx, parts.queue, lambda: uuid.uuid4().hex, context)
