"""Gates: rules declared before anything is scored by them."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import Body, Query, Response

from trueup_service.actions import find
from trueup_service.http.context import By, DigestPath, IdempotencyKey, Limit, PlantName, With, create
from trueup_service.http.guard import guarded
from trueup_service.http.openapi import there
from trueup_service.http.schemas import Gate, Page, page
from trueup_service.registry.store import Reader

router = guarded("/v1/plants/{plant}/gates", ["gates"])


@router.post("", status_code=201, response_model=Gate, summary="Declare a gate", responses=there(Gate))
def declare(
    parts: With,
    stamp: By,
    plant: PlantName,
    document: Annotated[dict[str, Any] | None, Body()] = None,
    key: IdempotencyKey = None,
) -> Response:
    """Without a body the default: rollouts below 0.98 of the incumbent's error, one step no worse, over every window of the horizon."""
    from trueup_service.actions.declare_gate import declare_gate  # noqa: PLC0415  (numpy: a server that only serves needs none)

    return create(parts, stamp, f"gates/{plant}", key, document, lambda w: declare_gate(w, plant, document, stamp), Gate)


@router.get("", summary="List gates")
def list_gates(parts: With, plant: PlantName, after: Annotated[str, Query(max_length=64)] = "", limit: Limit = 100) -> Page[Gate]:
    with parts.database.read() as connection:
        reader = Reader(connection)
        find.plant_digest(reader, plant)
        found = reader.gates(plant, after, limit)
    return page(Gate, found, limit, "digest")


@router.get("/{digest}", summary="Get a gate")
def get_gate(parts: With, plant: PlantName, digest: DigestPath) -> Gate:
    with parts.database.read() as connection:
        return Gate.model_validate(find.gate(Reader(connection), plant, digest))
