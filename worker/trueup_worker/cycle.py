"""The cycle as a job's effects continue it."""

from __future__ import annotations

import uuid

from trueup_service.actions.continue_cycle import Cycle
from trueup_service.actions.stamp import Stamp
from trueup_service.registry.store import Writer
from trueup_service.wiring import Parts


def cycle_of(parts: Parts, writer: Writer, stamp: Stamp) -> Cycle:
    """The cycle in a job's transaction."""
    return Cycle(writer, parts.queue, lambda: uuid.uuid4().hex, stamp)
