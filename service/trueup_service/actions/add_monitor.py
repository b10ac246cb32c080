"""Add a calibrated monitor, which watches its plant from then on."""

from __future__ import annotations

from typing import Any

from trueup.canonical import Json, digest_of
from trueup.ledger.operation import Operation
from trueup_service.actions.stamp import Stamp
from trueup_service.registry.records import MonitorRecord, Watching
from trueup_service.registry.store import Writer


def add_monitor(
    writer: Writer,
    plant: str,
    document: dict[str, Any],
    kept: dict[str, Json],
    job: str | None,
    since: str,
    stamp: Stamp,
) -> None:
    """Keep the monitor under its digest and let it watch what comes in after `since`; `kept` is
    what it knows at its beginning."""
    digest = digest_of(document)
    writer.lock_plant(plant)
    if writer.monitor(plant, digest) is None:
        writer.add_monitor(
            MonitorRecord(
                plant, digest, document["artifact"], document, job, stamp.now, stamp.actor
            )
        )
    writer.watch_with(Watching(plant, digest, since, writer.last_watch(plant, digest), kept))
    facts: dict[str, Json] = {
        "operation": Operation.MONITORING,
        "artifact": document["artifact"],
        "promise_h": document["promise_h"],
        "job": job,
    }
    writer.append_audit(
        at=stamp.now,
        kind="monitor:calibrated",
        actor=stamp.actor,
        plant=plant,
        subject=digest,
        facts=facts,
    )
