"""Outputs: the bytes of an artifact that a job made, durable before any row names them."""

from __future__ import annotations

from trueup.artifact.artifact import Artifact
from trueup_service.wiring import Parts, keep_bytes


def keep_arrays(parts: Parts, artifact: Artifact) -> str | None:
    """Put an artifact's arrays into the blob store; their digest, None where it has none. Repeating it changes nothing."""
    return keep_bytes(parts, artifact.arrays) if artifact.arrays else None
