"""Plants: register a machine by its plant.json, list, get."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Body, Query, Response

from trueup_service.actions import find
from trueup_service.http.context import By, IdempotencyKey, Limit, PlantName, With, create
from trueup_service.http.openapi import there
from trueup_service.http.schemas import Page, Plant, page
from trueup_service.registry.store import Reader

router = APIRouter(prefix="/v1/plants", tags=["plants"])


@router.post("", status_code=201, response_model=Plant, summary="Register a plant", responses=there(Plant))
def register(
    parts: With,
    stamp: By,
    document: Annotated[dict[str, Any], Body(description="plant.json")],
    key: IdempotencyKey = None,
) -> Response:
    """Its declared model becomes version 1 and serves at generation 1. The same description again answers 200."""
    from trueup_service.actions.register_plant import register_plant  # noqa: PLC0415  (numpy: a server that only serves needs none)

    return create(parts, stamp, "plants", key, document, lambda w: register_plant(w, document, stamp), Plant)


@router.get("", summary="List plants by name")
def list_plants(parts: With, after: Annotated[str, Query(max_length=63)] = "", limit: Limit = 100) -> Page[Plant]:
    with parts.database.read() as connection:
        found = Reader(connection).plants(after, limit)
    return page(Plant, found, limit, "name")


@router.get("/{plant}", summary="Get a plant")
def get_plant(parts: With, plant: PlantName) -> Plant:
    with parts.database.read() as connection:
        return Plant.model_validate(find.plant(Reader(connection), plant))
