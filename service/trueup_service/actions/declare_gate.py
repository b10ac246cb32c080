"""Declare a gate: the first of a plant, or one that takes the place of the gate in force."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from trueup.canonical import Json
from trueup.errors import BadGate
from trueup.gate.controls import require_can_reject
from trueup.gate.decision import Gate, default_gate
from trueup.gate.line import looser
from trueup.model.plant import Plant
from trueup_service.actions import find
from trueup_service.actor_context import END_OF_TIME, ActorContext
from trueup_service.control_characters import control_character
from trueup_service.errors import GateFollows
from trueup_service.registry.records import GateRecord
from trueup_service.registry.transaction import Transaction

NAMED_DECISIONS = 10  # decisions that a refusal names


def declare_gate(
    tx: Transaction, plant: str, document: Mapping[str, Json] | None, context: ActorContext
) -> tuple[GateRecord, bool]:
    """Declare a gate. Returns it, and whether it is new. Without a document it is the gate in
    force, or the default gate where there is none.

    Once a candidate of the plant has been judged, a new gate must name the gate in force and give a
    reason. Raises BadGate, VacuousGate, GateFollows, NotFound.
    """
    registered = find.plant(tx, plant)
    declared = None if document is None else Gate.from_document(document)
    tx.plants.lock(plant)
    line = tx.gates.in_order(plant)
    if declared is None and line:
        return line[-1], False
    gate = (
        default_gate(Plant.from_document(registered.document).horizon_s)
        if declared is None
        else declared
    )
    known = next((g for g in line if g.digest == gate.digest), None)
    if known is not None:
        return known, False
    if gate.because is not None and (character := control_character(gate.because, allowed="\n\t")):
        raise BadGate(
            f"because holds the control character {character}: write it as text that can be read",
            field="because",
        )
    twice = [name for name, count in Counter(rule.name for rule in gate.rules).items() if count > 1]
    if twice:
        raise BadGate(
            f"it holds the rule {twice[0]} twice: one of them is idle",
            hint="Name each rule once.",
            rules=list(twice),
        )
    require_can_reject(gate)
    _require_follows(tx, plant, gate, line)
    record = GateRecord(
        plant=plant,
        digest=gate.digest,
        document=gate.document(),
        created_at=context.now,
        created_by=context.actor,
    )
    tx.gates.add(record)
    facts: dict[str, Json] = {"gate": gate.document()}
    if line:
        facts |= {
            "in_place_of": line[-1].digest,
            "looser": list(looser(line[-1].document, gate.document())),
        }
    tx.log.append(context, "gate:declared", plant=plant, subject=gate.digest, facts=facts)
    return record, True


def _require_follows(tx: Transaction, plant: str, gate: Gate, line: Sequence[GateRecord]) -> None:
    """Raises GateFollows where the gate must name the gate in force and does not, and BadGate where
    it names another one."""
    last = line[-1] if line else None
    if gate.follows is not None and (last is None or gate.follows != last.digest):
        in_force = "none is in force" if last is None else f"{last.digest[:12]} is in force"
        raise BadGate(
            f"it follows {gate.follows[:12]}, and {in_force}",
            field="follows",
            in_force=None if last is None else last.digest,
        )
    if last is None or gate.follows is not None:
        return
    scored: list[Any] = tx.decisions.page(plant, END_OF_TIME, NAMED_DECISIONS)
    if not scored and not tx.jobs.has_trial(plant):
        return
    facts: dict[str, Any] = {
        "in_force": last.digest,
        "looser": looser(last.document, gate.document()),
        "decisions": [d.digest for d in scored],
    }
    raise GateFollows(
        (
            f"gate {last.digest[:12]} is in force, and this plant's gates have judged "
            "candidates, or are about to"
        ),
        **facts,
    )
