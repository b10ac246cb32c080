"""What the service answers with, where a program looks inside."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

Document = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Serving:
    """Which artifact answers for a plant. `generation` only grows; `since` is UTC, ISO 8601."""

    plant: str
    version: int
    artifact: str
    generation: int
    since: str
    decision: str | None
    move: str
    actor: str
