"""Add an artifact as the next version of its plant's model."""

from __future__ import annotations

from trueup.artifact.artifact import Artifact
from trueup.canonical import Json
from trueup.errors import BadArtifact
from trueup.ledger.operation import of_artifact
from trueup_service.actions import find
from trueup_service.actor_context import ActorContext
from trueup_service.registry.records import ArtifactRecord
from trueup_service.registry.transaction import Transaction


def add_artifact(
    tx: Transaction, plant: str, artifact: Artifact, job: str | None, context: ActorContext
) -> tuple[ArtifactRecord, bool]:
    """Add an artifact that was unpacked before, and whose arrays are durable. Returns its version,
    and whether it is new. Raises BadArtifact."""
    require_plant(artifact, find.plant_digest(tx, plant))
    tx.plants.lock(plant)
    known = tx.artifacts.get(plant, artifact.digest)
    if known is not None:
        return known, False
    document = artifact.document
    arrays = document["arrays"]["sha256"] if isinstance(document["arrays"], dict) else None
    version = tx.artifacts.latest_version(plant) + 1
    record = ArtifactRecord(
        plant=plant,
        version=version,
        digest=artifact.digest,
        kind=str(document["kind"]),
        manifest=artifact.manifest.decode(),
        arrays=arrays and str(arrays),
        job=job,
        created_at=context.now,
        created_by=context.actor,
    )
    tx.artifacts.add(record)
    facts: dict[str, Json] = {
        "version": version,
        "kind": record.kind,
        "operation": of_artifact(record.kind, document["predictor"]),
        "arrays": record.arrays,
        "job": job,
    }
    tx.log.append(context, "artifact:added", plant=plant, subject=artifact.digest, facts=facts)
    return record, True


def require_plant(artifact: Artifact, digest: str) -> None:
    """Raises BadArtifact where the artifact was made for another description of the plant."""
    made_for = artifact.document.get("plant")
    if not isinstance(made_for, dict) or made_for.get("sha256") != digest:
        raise BadArtifact(
            "the artifact was made for another plant",
            expected=digest,
            hint="Fit it again for this plant's description.",
        )
