"""Outputs of jobs: bytes that are durable before any row names them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from trueup.artifact.artifact import Artifact
from trueup.canonical import Json, canonical_bytes
from trueup_service.actor_context import ActorContext
from trueup_service.registry.records import JobRecord, OutputRecord
from trueup_service.registry.transaction import Transaction
from trueup_service.wiring import Parts, keep_bytes

REPORT_FILE = "report.json"


def keep_arrays(parts: Parts, artifact: Artifact) -> str | None:
    """Stores an artifact's arrays as a blob, and returns its digest; None if it has no arrays.

    Repeating it changes nothing.
    """
    return keep_bytes(parts, artifact.arrays) if artifact.arrays else None


def keep_file(parts: Parts, name: str, media_type: str, content: bytes) -> dict[str, Json]:
    """Stores a file of a job as a blob, and returns the fields of its row.

    Repeating it changes nothing.
    """
    return {
        "name": name,
        "media_type": media_type,
        "size_bytes": len(content),
        "digest": keep_bytes(parts, content),
    }


def keep_report(parts: Parts, document: dict[str, Any]) -> dict[str, Json]:
    """Stores a study's report as a file, and returns the outcome of its job: the file, and the
    report without the runs that are drawn."""
    content = canonical_bytes(document)
    return {
        "files": [keep_file(parts, REPORT_FILE, "application/json", content)],
        "report": _without_drawn(document),
    }


def leave_files(
    parts: Parts, tx: Transaction, job: JobRecord, outcome: dict[str, Any], context: ActorContext
) -> None:
    """The effects of a job that leaves files behind and changes nothing else."""
    add_files(tx, job, outcome["files"])


def report_of(outcome: dict[str, Any]) -> dict[str, Json]:
    """The result of a job that is its report."""
    return {"report": outcome["report"]}


def _without_drawn(document: Json) -> Json:
    """A document without its keys `drawn`, at any depth."""
    if isinstance(document, dict):
        return {k: _without_drawn(v) for k, v in document.items() if k != "drawn"}
    return [_without_drawn(x) for x in document] if isinstance(document, list) else document


def add_files(tx: Transaction, job: JobRecord, files: Sequence[dict[str, Any]]) -> None:
    """Writes the rows of a job's files."""
    for file in files:
        tx.outputs.add(OutputRecord(plant=job.plant, job=job.id, **file))
