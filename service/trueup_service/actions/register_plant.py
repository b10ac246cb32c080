"""Register a plant: its declared model becomes version 1 and serves at generation 1."""

from __future__ import annotations

from trueup.artifact.artifact import nominal_artifact
from trueup.canonical import Json
from trueup.model.plant import Plant
from trueup_service.actions import find
from trueup_service.actor_context import ActorContext
from trueup_service.errors import Conflict
from trueup_service.registry.records import ArtifactRecord, Move, MoveKind, PlantRecord
from trueup_service.registry.transaction import Transaction


def register_plant(
    tx: Transaction, document: object, context: ActorContext, project: str | None = None
) -> tuple[PlantRecord, bool]:
    """Register a plant. Returns it, and whether it is new. Raises BadPlant, NotFound for an unknown
    project, and Conflict where the name has another description."""
    plant = Plant.from_document(document)
    if project is not None:
        find.project(tx, project)
    tx.lock_name(f"plant {plant.name}")
    known = tx.plants.get(plant.name)
    if known is not None and project is not None and known.project != project:
        raise Conflict(f"the name {plant.name!r} is taken", hint="Choose another name.")
    if known is not None:
        if known.digest != plant.digest:
            raise Conflict(
                f"plant {plant.name!r} is registered with another description",
                registered=known.digest,
                sent=plant.digest,
            )
        return known, False
    plant.require_known_envelope()
    record = PlantRecord(
        name=plant.name,
        digest=plant.digest,
        document=dict(plant.document),
        created_at=context.now,
        created_by=context.actor,
        project=project,
    )
    artifact = nominal_artifact(plant)
    tx.plants.add(record)
    tx.artifacts.add(
        ArtifactRecord(
            plant=plant.name,
            version=1,
            digest=artifact.digest,
            kind="nominal",
            manifest=artifact.manifest.decode(),
            arrays=None,
            job=None,
            created_at=context.now,
            created_by=context.actor,
        )
    )
    tx.serving.begin(
        Move(
            plant=plant.name,
            generation=1,
            kind=MoveKind.REGISTERED,
            artifact=artifact.digest,
            version=1,
            decision=None,
            back_to=None,
            at=context.now,
            actor=context.actor,
        )
    )
    facts: dict[str, Json] = {
        "plant": plant.digest,
        "artifact": artifact.digest,
        "generation": 1,
        "project": project,
    }
    tx.log.append(context, "plant:registered", plant=plant.name, subject=plant.digest, facts=facts)
    return record, True
