"""Calls on artifacts: the versions of a plant's model, their bytes, and the evidence on them."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterator, Mapping
from pathlib import Path

from trueup_client.files import arrays_digest
from trueup_client.records import Artifact, Document, Envelope, Evidence
from trueup_client.transport import Transport, url_path


class ArtifactCalls(Transport):
    """Artifacts and evidence."""

    def artifacts(self, plant: str) -> Iterator[Artifact]:
        """Yields every version of a plant's model."""
        return self._pages(url_path("plants", plant, "artifacts"), "after")

    def artifact(self, plant: str, digest: str) -> Artifact:
        """Returns an artifact by its digest."""
        return self._get(url_path("plants", plant, "artifacts", digest))

    def version(self, plant: str, version: int) -> Artifact:
        """Returns an artifact by its version number."""
        return self._get(url_path("plants", plant, "versions", version))

    def manifest_digest(self, plant: str, digest: str) -> str:
        """Returns the SHA-256 of the manifest that the service stores under this digest."""
        manifest = self._connection.whole(
            "GET", url_path("plants", plant, "artifacts", digest, "manifest"), lambda: None
        )
        return hashlib.sha256(manifest).hexdigest()

    def add_artifact(self, plant: str, manifest: bytes, arrays: bytes = b"") -> Artifact:
        """Adds a version: first its arrays under their digest, then the manifest's exact bytes."""
        if arrays:
            self._connection.whole(
                "PUT",
                url_path("blobs", hashlib.sha256(arrays).hexdigest()),
                lambda: arrays,
                {"Content-Type": "application/octet-stream"},
            )
        headers = {
            "Content-Type": "application/json",
            "Idempotency-Key": hashlib.sha256(manifest).hexdigest(),
        }
        return json.loads(
            self._connection.whole(
                "POST", url_path("plants", plant, "artifacts"), lambda: manifest, headers
            )
        )

    def fetch(self, plant: str, digest: str, folder: str | os.PathLike[str]) -> Path:
        """Fetches an artifact into a folder as manifest.json and arrays.safetensors.

        Returns the folder. Raises DigestMismatch if any byte is not what the digest names.
        """
        target = Path(folder)
        target.mkdir(parents=True, exist_ok=True)
        manifest, arrays = target / "manifest.json", target / "arrays.safetensors"
        self._save(url_path("plants", plant, "artifacts", digest, "manifest"), digest, manifest)
        arrays.unlink(missing_ok=True)
        expected = arrays_digest(manifest)
        if expected is not None:
            self._save(url_path("plants", plant, "artifacts", digest, "arrays"), expected, arrays)
        return target

    def blob_parts(self, digest: str) -> Iterator[bytes]:
        """Yields an artifact's arrays in parts, not verified."""
        return self._connection.parts(url_path("blobs", digest))

    def artifact_provenance(self, plant: str, digest: str) -> Envelope:
        """Returns where an artifact comes from: an in-toto statement in a signed envelope."""
        return self._get(url_path("plants", plant, "artifacts", digest, "provenance"))

    def membership(
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
        given = None if parameters is None else json.dumps(dict(parameters))
        return self._get(
            url_path("plants", plant, "artifacts", digest, "membership", of=of, parameters=given)
        )

    def add_evidence(self, plant: str, document: Document) -> Evidence:
        """Adds what a stage showed of an artifact.

        Fields: artifact, stage, passed, shows, cannot_show, figures.
        """
        return self._post(
            url_path("plants", plant, "evidence"), {"schema": "trueup.evidence/1", **document}
        )

    def evidence(self, plant: str, artifact: str) -> list[Evidence]:
        """Returns all the evidence on an artifact, in the order in which it was added."""
        return list(
            self._pages(url_path("plants", plant, "artifacts", artifact, "evidence"), "after")
        )
