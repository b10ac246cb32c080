"""The correction cycle, as the effects of a job continue it."""

from __future__ import annotations

import uuid

from trueup_service.actions.continue_cycle import Cycle
from trueup_service.actions.stamp import Stamp
from trueup_service.registry.store import Writer
from trueup_service.wiring import Parts


def cycle_of(parts: Parts, writer: Writer, stamp: Stamp) -> Cycle:
    """Returns the correction cycle within a job's transaction."""
    return Cycle(writer, parts.queue, lambda: uuid.uuid4().hex, stamp)
