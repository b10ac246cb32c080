"""Record a decision with every figure that it rests on."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

from trueup.canonical import Json, digest_of
from trueup.ledger.operation import Operation
from trueup_service.actions.gate_line import DECIDED
from trueup_service.actor_context import ActorContext
from trueup_service.registry.records import DecisionRecord
from trueup_service.registry.transaction import Transaction


def record_decision(
    tx: Transaction,
    plant: str,
    document: dict[str, Any],
    job: str | None,
    context: ActorContext,
    rehearsed: Mapping[str, Json] = MappingProxyType({}),
) -> DecisionRecord:
    """Record a decision's document under its digest. The same trial decided again is the same
    decision. `rehearsed` is the record of the way back from its candidate, where it was accepted;
    the log's entry keeps it until the pointer moves."""
    digest = digest_of(document)
    tx.plants.lock(plant)
    known = tx.decisions.get(digest)
    if known is not None:
        return known
    record = DecisionRecord(
        digest=digest,
        plant=plant,
        gate=document["gate"],
        candidate=document["candidate"],
        incumbent=document["incumbent"],
        generation=document["generation"],
        accepted=document["accepted"],
        document=document,
        job=job,
        created_at=context.now,
        created_by=context.actor,
    )
    tx.decisions.add(record)
    facts: dict[str, Json] = {"operation": Operation.CORRECTION, "decision": document, "job": job}
    if rehearsed:
        facts["rehearsed"] = dict(rehearsed)
    tx.log.append(context, DECIDED, plant=plant, subject=digest, facts=facts)
    return record
