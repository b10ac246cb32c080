"""Add evidence of an artifact at a stage."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from trueup.canonical import Json
from trueup.gate.evidence import BadEvidence, Evidence
from trueup_service.actions import find
from trueup_service.actor_context import ActorContext
from trueup_service.control_characters import control_character
from trueup_service.registry.records import EvidenceRecord
from trueup_service.registry.transaction import Transaction

LONGEST_TEXT = 10_000  # characters that a person reads


def add_evidence(
    tx: Transaction, plant: str, document: Mapping[str, Any], job: str | None, context: ActorContext
) -> tuple[EvidenceRecord, bool]:
    """Add evidence. Returns it, and whether it is new: the same document is the same evidence.
    Raises BadEvidence, NotFound."""
    evidence = Evidence.from_document(document)
    for field, text in (("shows", evidence.shows), ("cannot_show", evidence.cannot_show)):
        if len(text) > LONGEST_TEXT:
            raise BadEvidence(
                (
                    f"{field} has more than {LONGEST_TEXT} characters: say it in short, and name "
                    "what says more"
                ),
                field=field,
            )
        if character := control_character(text, allowed="\n\t"):
            raise BadEvidence(
                (
                    f"{field} holds the control character {character}: write it as text that can "
                    "be read"
                ),
                field=field,
            )
    find.artifact(tx, plant, evidence.artifact)
    tx.plants.lock(plant)
    known = tx.evidence.get(plant, evidence.digest)
    if known is not None:
        return known, False
    record = EvidenceRecord(
        plant=plant,
        digest=evidence.digest,
        artifact=evidence.artifact,
        stage=evidence.stage,
        passed=evidence.passed,
        document=evidence.document(),
        job=job,
        created_at=context.now,
        created_by=context.actor,
    )
    tx.evidence.add(record)
    facts: dict[str, Json] = {
        "artifact": evidence.artifact,
        "stage": evidence.stage,
        "passed": evidence.passed,
        "job": job,
    }
    tx.log.append(context, "evidence:added", plant=plant, subject=evidence.digest, facts=facts)
    return record, True
