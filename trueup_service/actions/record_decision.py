"""Record a decision with every figure that it rests on."""

from __future__ import annotations

from typing import Any

from trueup.canonical import digest_of
from trueup_service.actions.stamp import Stamp
from trueup_service.registry.records import DecisionRecord
from trueup_service.registry.store import Writer


def record_decision(writer: Writer, plant: str, document: dict[str, Any], job: str | None, stamp: Stamp) -> None:
    """Keep a decision's document under its digest; the same trial decided again is the same decision."""
    digest = digest_of(document)
    writer.lock_plant(plant)
    if writer.decision(digest) is not None:
        return
    parts = document["gate"], document["candidate"], document["incumbent"], document["generation"], document["accepted"]
    writer.add_decision(DecisionRecord(digest, plant, *parts, document, job, stamp.now, stamp.actor))
    writer.append_audit(
        at=stamp.now, kind="decision:made", actor=stamp.actor, plant=plant, subject=digest, facts={"decision": document, "job": job}
    )
