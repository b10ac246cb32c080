"""Outputs: the bytes that a job made, durable before any row names them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from trueup.artifact.artifact import Artifact
from trueup.canonical import Json
from trueup_service.registry.records import JobRecord, OutputRecord
from trueup_service.registry.transaction import Transaction
from trueup_service.wiring import Parts, keep_bytes


def keep_arrays(parts: Parts, artifact: Artifact) -> str | None:
    """Put an artifact's arrays into the blob store; their digest, None where it has none. Repeating
    it changes nothing."""
    return keep_bytes(parts, artifact.arrays) if artifact.arrays else None


def keep_file(parts: Parts, name: str, media_type: str, content: bytes) -> dict[str, Json]:
    """Put a file that a job leaves behind into the blob store; what its row will say. Repeating it
    changes nothing."""
    return {
        "name": name,
        "media_type": media_type,
        "size_bytes": len(content),
        "digest": keep_bytes(parts, content),
    }


def add_files(tx: Transaction, job: JobRecord, files: Sequence[dict[str, Any]]) -> None:
    """Name the files that a job left behind."""
    for file in files:
        tx.outputs.add(OutputRecord(plant=job.plant, job=job.id, **file))
