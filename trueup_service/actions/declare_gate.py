"""Declare a gate, before anything is scored by it."""

from __future__ import annotations

from collections.abc import Mapping

from trueup.canonical import Json
from trueup.gate.decision import Gate, default_gate
from trueup.model.plant import Plant
from trueup_service.actions import find
from trueup_service.actions.stamp import Stamp
from trueup_service.registry.records import GateRecord
from trueup_service.registry.store import Writer


def declare_gate(writer: Writer, plant: str, document: Mapping[str, Json] | None, stamp: Stamp) -> tuple[GateRecord, bool]:
    """The gate, and whether it is new; the default one if no document is given. Raises BadGate."""
    registered = find.plant(writer, plant)
    gate = default_gate(Plant.from_document(registered.document).horizon_s) if document is None else Gate.from_document(document)
    writer.lock_plant(plant)
    known = writer.gate(plant, gate.digest)
    if known is not None:
        return known, False
    record = GateRecord(plant, gate.digest, gate.document(), stamp.now, stamp.actor)
    writer.add_gate(record)
    writer.append_audit(
        at=stamp.now, kind="gate:declared", actor=stamp.actor, plant=plant, subject=gate.digest, facts={"gate": gate.document()}
    )
    return record, True
