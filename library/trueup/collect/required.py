"""Required: what a policy may ask of a recording of a machine before it is used."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

SAFEGUARDS = "safeguards"
ON_A_MACHINE = ("HIL", "physical")  # stages at which something can be hurt


def refusal_of(summary: Mapping[str, Any], conditions: Mapping[str, str]) -> str | None:
    """Why an episode's summary does not show that it was collected under safeguards that held; None
    where it does, or where it was recorded on no machine."""
    if conditions.get("stage") not in ON_A_MACHINE:
        return None
    record = (summary.get("collection") or {}).get(SAFEGUARDS) or {}
    if not record.get("checked"):
        return "it does not declare safeguards and a stop criterion that can be checked"
    if record.get("held") is None:
        return "its recording does not tell whether they held"
    return None if record["held"] else "its recording breaks them"
