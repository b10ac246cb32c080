"""Decisions: what gates decided, with every figure."""

from __future__ import annotations

from fastapi import APIRouter

from trueup_service.actions import find
from trueup_service.http.context import END_OF_TIME, Before, DigestPath, Limit, PlantName, With
from trueup_service.http.schemas import Decision, Page, page
from trueup_service.registry.store import Reader

router = APIRouter(prefix="/v1", tags=["decisions"])


@router.get("/plants/{plant}/decisions", summary="List decisions, the newest first")
def list_decisions(parts: With, plant: PlantName, before: Before = END_OF_TIME, limit: Limit = 100) -> Page[Decision]:
    with parts.database.read() as connection:
        reader = Reader(connection)
        find.plant_digest(reader, plant)
        found = reader.decisions(plant, before, limit)
    return page(Decision, found, limit, "created_at")


@router.get("/plants/{plant}/decisions/{digest}", summary="Get a decision of a plant")
def get_decision(parts: With, plant: PlantName, digest: DigestPath) -> Decision:
    with parts.database.read() as connection:
        return Decision.model_validate(find.decision(Reader(connection), plant, digest))


@router.get("/decisions/{digest}", summary="Get a decision by its digest alone")
def find_decision(parts: With, digest: DigestPath) -> Decision:
    with parts.database.read() as connection:
        return Decision.model_validate(find.any_decision(Reader(connection), digest))
