"""Add a calibrated monitor, which watches its plant from then on."""

from __future__ import annotations

from typing import Any

from trueup.canonical import Json, digest_of
from trueup.ledger.operation import Operation
from trueup_service.actor_context import ActorContext
from trueup_service.registry.records import MonitorRecord, Watching
from trueup_service.registry.transaction import Transaction


def add_monitor(
    tx: Transaction,
    plant: str,
    document: dict[str, Any],
    kept: dict[str, Json],
    job: str | None,
    since: str,
    context: ActorContext,
) -> None:
    """Add a monitor under its digest, and let it watch the episodes that come in after `since`.
    `kept` is the initial state of its detectors."""
    digest = digest_of(document)
    tx.plants.lock(plant)
    if tx.monitors.get(plant, digest) is None:
        tx.monitors.add(
            MonitorRecord(
                plant=plant,
                digest=digest,
                artifact=document["artifact"],
                document=document,
                job=job,
                created_at=context.now,
                created_by=context.actor,
            )
        )
    tx.watches.begin(
        Watching(
            plant=plant,
            monitor=digest,
            since=since,
            sequence=tx.watches.last_sequence(plant, digest),
            kept=kept,
        )
    )
    facts: dict[str, Json] = {
        "operation": Operation.MONITORING,
        "artifact": document["artifact"],
        "promise_h": document["promise_h"],
        "job": job,
    }
    tx.log.append(context, "monitor:calibrated", plant=plant, subject=digest, facts=facts)
