"""The route of families of plants: whether a plant lies in the boxes of a model that was fitted to
one."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Annotated, Any

from fastapi import Query

from trueup.canonical import Json
from trueup.errors import BadPlant, BadRandomisation
from trueup.model.fields import Reader
from trueup.randomise.membership import box_of_document, membership
from trueup_service.actions import find
from trueup_service.errors import NotFound
from trueup_service.http.dependencies import Digest, PlantName, RequestParts
from trueup_service.http.guard import guarded
from trueup_service.http.schemas.families import Membership
from trueup_service.registry.records import ArtifactRecord
from trueup_service.registry.transaction import reading

router = guarded("/v1", ["families"])
BOXES = ("family_box", "sample_box")
LONGEST = 4096  # characters of the values


@router.get(
    "/plants/{plant}/artifacts/{digest}/membership",
    summary="Whether a plant lies in the family of a model, and among its samples",
)
def get_membership(
    parts: RequestParts,
    plant: PlantName,
    digest: Digest,
    of: Annotated[
        Digest | None,
        Query(
            description="A version whose parameters are looked up; default: the newest identified"
        ),
    ] = None,
    parameters: Annotated[
        str | None,
        Query(
            max_length=LONGEST,
            description='The parameters themselves instead, as a JSON object: {"k": 1.25}',
        ),
    ] = None,
) -> Membership:
    """Two answers of a blind or conditioned model: inside the declared family box, and inside the
    box of the samples that were drawn. They may differ. `inside` is null where a parameter is not
    known, or where no family was declared."""
    with reading(parts.database) as tx:
        boxes = _boxes(find.artifact(tx, plant, digest))
        if parameters is not None:
            values = _given(parameters)
        else:
            newest = tx.artifacts.newest_of_kind(plant, "identified")
            record = find.artifact(tx, plant, of) if of is not None else newest
            if record is None:
                raise NotFound(
                    "no version has identified parameters",
                    noun="version",
                    name=plant,
                    hint="Fit one with the method identify, or send `parameters`.",
                )
            declared: Any = _manifest(record).get("predictor", {}).get("parameters", {})
            values = {str(name): float(value) for name, value in declared.items()}
    answers: dict[str, Any] = {
        name: None if box is None else membership(box_of_document(box), values)
        for name, box in boxes.items()
    }
    return Membership(artifact=digest, parameters=values, **answers)


def _boxes(record: ArtifactRecord) -> dict[str, dict[str, Json] | None]:
    """The boxes that a model's provenance holds. Raises NotFound where it was fitted to no
    family."""
    written: Any = _manifest(record).get("provenance", {}).get("randomisation")
    boxes = {name: written.get(name) for name in BOXES} if isinstance(written, Mapping) else {}
    if not any(boxes.values()):
        raise NotFound(
            f"version {record.version} was fitted to no family of plants",
            noun="family",
            name=record.digest,
            hint="Name a version of the kind blind or conditioned.",
        )
    return boxes


def _manifest(record: ArtifactRecord) -> dict[str, Any]:
    manifest: dict[str, Any] = json.loads(record.manifest)
    return manifest


def _given(text: str) -> dict[str, float]:
    try:
        return Reader.of_text(text, "parameters").every_number()
    except BadPlant as error:
        raise BadRandomisation(
            f"`parameters` is no JSON object of numbers: {error.message}",
            field="parameters",
            hint='Send such as {"k": 1.25, "c": 0.62}.',
        ) from error
