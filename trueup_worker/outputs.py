"""Outputs: the bytes of an artifact that a job made, durable before any row names them."""

from __future__ import annotations

import uuid

from trueup.artifact.artifact import Artifact
from trueup.canonical import digest_of_bytes
from trueup_service.wiring import Parts


def keep_arrays(parts: Parts, artifact: Artifact) -> str | None:
    """Put an artifact's arrays into the blob store; their digest, None where it has none. Repeating it changes nothing."""
    if not artifact.arrays:
        return None
    digest, path = digest_of_bytes(artifact.arrays), parts.spool / uuid.uuid4().hex
    path.write_bytes(artifact.arrays)
    try:
        parts.blobs.put(digest, path)
    finally:
        path.unlink(missing_ok=True)
    return digest
