"""Register a plant: its declared model becomes version 1 and serves at generation 1."""

from __future__ import annotations

from trueup.artifact.artifact import nominal_artifact
from trueup.canonical import Json
from trueup.model.plant import Plant
from trueup_service.actions import find
from trueup_service.actions.stamp import Stamp
from trueup_service.errors import Conflict
from trueup_service.registry.records import ArtifactRecord, Move, MoveKind, PlantRecord
from trueup_service.registry.store import Writer


def register_plant(
    writer: Writer, document: object, stamp: Stamp, project: str | None = None
) -> tuple[PlantRecord, bool]:
    """The plant, and whether it is new. Raises BadPlant, NotFound for a project, and Conflict if
    the name has another description."""
    plant = Plant.from_document(document)
    if project is not None:
        find.project(writer, project)
    writer.lock_name(f"plant {plant.name}")
    known = writer.plant(plant.name)
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
        plant.name, plant.digest, dict(plant.document), stamp.now, stamp.actor, project
    )
    artifact = nominal_artifact(plant)
    writer.add_plant(record)
    writer.add_artifact(
        ArtifactRecord(
            plant.name,
            1,
            artifact.digest,
            "nominal",
            artifact.manifest.decode(),
            None,
            None,
            stamp.now,
            stamp.actor,
        )
    )
    writer.begin_serving(
        Move(
            plant.name,
            1,
            MoveKind.REGISTERED,
            artifact.digest,
            1,
            None,
            None,
            stamp.now,
            stamp.actor,
        )
    )
    facts: dict[str, Json] = {
        "plant": plant.digest,
        "artifact": artifact.digest,
        "generation": 1,
        "project": project,
    }
    writer.append_audit(
        at=stamp.now,
        kind="plant:registered",
        actor=stamp.actor,
        plant=plant.name,
        subject=plant.digest,
        facts=facts,
    )
    return record, True
