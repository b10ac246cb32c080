"""Decisions: what gates decided, with every figure."""

from __future__ import annotations

from fastapi import APIRouter

from trueup_service.actions import find
from trueup_service.http.context import END_OF_TIME, Before, DigestPath, Limit, PlantName, With
from trueup_service.http.schemas import Decision, Page
from trueup_service.registry.store import Reader

router = APIRouter(prefix="/v1/plants/{plant}/decisions", tags=["decisions"])


@router.get("", summary="List decisions, the newest first")
def list_decisions(parts: With, plant: PlantName, before: Before = END_OF_TIME, limit: Limit = 100) -> Page[Decision]:
    with parts.database.read() as connection:
        reader = Reader(connection)
        find.plant(reader, plant)
        found = reader.decisions(plant, before, limit)
    return Page(items=[Decision.model_validate(d) for d in found], next=found[-1].created_at if len(found) == limit else None)


@router.get("/{digest}", summary="Get a decision")
def get_decision(parts: With, plant: PlantName, digest: DigestPath) -> Decision:
    with parts.database.read() as connection:
        return Decision.model_validate(find.decision(Reader(connection), plant, digest))
