"""The calls of trueup_client.calls.artifacts for an event loop.

Made by tools/make_async_client.py.
"""

from __future__ import annotations

import os
from collections.abc import AsyncIterator, Mapping
from pathlib import Path

from trueup_client.calls.artifacts import ArtifactCalls
from trueup_client.pool import Pooled
from trueup_client.records import Artifact, Document, Envelope, Evidence


class AsyncArtifactCalls(Pooled):
    """Artifacts and evidence. For an event loop."""

    def artifacts(self, plant: str) -> AsyncIterator[Artifact]:
        """Yields every version of a plant's model."""
        return self._pool.each(ArtifactCalls.artifacts, plant)

    async def artifact(self, plant: str, digest: str) -> Artifact:
        """Returns an artifact by its digest."""
        return await self._pool.run(ArtifactCalls.artifact, plant, digest)

    async def version(self, plant: str, version: int) -> Artifact:
        """Returns an artifact by its version number."""
        return await self._pool.run(ArtifactCalls.version, plant, version)

    async def manifest_digest(self, plant: str, digest: str) -> str:
        """Returns the SHA-256 of the manifest that the service stores under this digest."""
        return await self._pool.run(ArtifactCalls.manifest_digest, plant, digest)

    async def add_artifact(self, plant: str, manifest: bytes, arrays: bytes = b"") -> Artifact:
        """Adds a version: first its arrays under their digest, then the manifest's exact bytes."""
        return await self._pool.run(ArtifactCalls.add_artifact, plant, manifest, arrays)

    async def fetch(self, plant: str, digest: str, folder: str | os.PathLike[str]) -> Path:
        """Fetches an artifact into a folder as manifest.json and arrays.safetensors.

        Returns the folder. Raises DigestMismatch if any byte is not what the digest names.
        """
        return await self._pool.run(ArtifactCalls.fetch, plant, digest, folder)

    def blob_parts(self, digest: str) -> AsyncIterator[bytes]:
        """Yields an artifact's arrays in parts, not verified."""
        return self._pool.each(ArtifactCalls.blob_parts, digest)

    async def artifact_provenance(self, plant: str, digest: str) -> Envelope:
        """Returns where an artifact comes from: an in-toto statement in a signed envelope."""
        return await self._pool.run(ArtifactCalls.artifact_provenance, plant, digest)

    async def membership(
        self,
        plant: str,
        digest: str,
        of: str | None = None,
        parameters: Mapping[str, float] | None = None,
    ) -> Document:
        """Returns whether a plant lies in the family box and in the sample box of a model.

        The plant's parameters are those of the version `of`, of the newest identified one by
        default, or the ones given.
        """
        return await self._pool.run(ArtifactCalls.membership, plant, digest, of, parameters)

    async def add_evidence(self, plant: str, document: Document) -> Evidence:
        """Adds what a stage showed of an artifact.

        Fields: artifact, stage, passed, shows, cannot_show, figures.
        """
        return await self._pool.run(ArtifactCalls.add_evidence, plant, document)

    async def evidence(self, plant: str, artifact: str) -> list[Evidence]:
        """Returns all the evidence on an artifact, in the order in which it was added."""
        return await self._pool.run(ArtifactCalls.evidence, plant, artifact)
