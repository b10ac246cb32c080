"""Add evidence of an artifact at a stage."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from trueup.canonical import Json
from trueup.gate.evidence import BadEvidence, Evidence
from trueup_service.actions import find
from trueup_service.actions.stamp import Stamp
from trueup_service.plain_text import obeyed_character
from trueup_service.registry.records import EvidenceRecord
from trueup_service.registry.store import Writer

LONGEST_TEXT = 10_000  # characters; what is read, not what is looked up


def add_evidence(
    writer: Writer, plant: str, document: Mapping[str, Any], job: str | None, stamp: Stamp
) -> tuple[EvidenceRecord, bool]:
    """The evidence, and whether it is new: the same document is the same evidence. Raises
    BadEvidence, NotFound."""
    found = Evidence.from_document(document)
    for field, text in (("shows", found.shows), ("cannot_show", found.cannot_show)):
        if len(text) > LONGEST_TEXT:
            raise BadEvidence(
                (
                    f"{field} has more than {LONGEST_TEXT} characters: say it in short, and name "
                    "what says more"
                ),
                field=field,
            )
        if character := obeyed_character(text, allowed="\n\t"):
            raise BadEvidence(
                (
                    f"{field} holds the control character {character}: write it as text that can "
                    "be read"
                ),
                field=field,
            )
    find.artifact(writer, plant, found.artifact)
    writer.lock_plant(plant)
    known = writer.evidence(plant, found.digest)
    if known is not None:
        return known, False
    record = EvidenceRecord(
        plant,
        found.digest,
        found.artifact,
        found.stage,
        found.passed,
        found.document(),
        job,
        stamp.now,
        stamp.actor,
    )
    writer.add_evidence(record)
    facts: dict[str, Json] = {
        "artifact": found.artifact,
        "stage": found.stage,
        "passed": found.passed,
        "job": job,
    }
    writer.append_audit(
        at=stamp.now,
        kind="evidence:added",
        actor=stamp.actor,
        plant=plant,
        subject=found.digest,
        facts=facts,
    )
    return record, True
