"""Record a decision with every figure that it rests on."""

from __future__ import annotations

from typing import Any

from trueup.canonical import Json, digest_of
from trueup.ledger.operation import Operation
from trueup_service.actions.stamp import Stamp
from trueup_service.registry.records import DecisionRecord
from trueup_service.registry.store import Writer


def record_decision(
    writer: Writer, plant: str, document: dict[str, Any], job: str | None, stamp: Stamp
) -> DecisionRecord:
    """Keep a decision's document under its digest; the same trial decided again is the same
    decision."""
    digest = digest_of(document)
    writer.lock_plant(plant)
    known = writer.decision(digest)
    if known is not None:
        return known
    parts = (
        document["gate"],
        document["candidate"],
        document["incumbent"],
        document["generation"],
        document["accepted"],
    )
    record = DecisionRecord(digest, plant, *parts, document, job, stamp.now, stamp.actor)
    writer.add_decision(record)
    facts: dict[str, Json] = {"operation": Operation.CORRECTION, "decision": document, "job": job}
    writer.append_audit(
        at=stamp.now,
        kind="decision:made",
        actor=stamp.actor,
        plant=plant,
        subject=digest,
        facts=facts,
    )
    return record
