"""Decisions: what gates decided, with every figure."""

from __future__ import annotations

from fastapi import APIRouter, Request

from trueup.canonical import Json, digest_of
from trueup.errors import BrokenChain
from trueup.ledger.provenance import PAYLOAD_TYPE, of_decision
from trueup_service.actions import find
from trueup_service.http.context import END_OF_TIME, Before, DigestPath, Limit, PlantName, With
from trueup_service.http.schemas import Decision, Envelope, Page, page
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


@router.get("/plants/{plant}/decisions/{digest}/provenance", summary="What a gate said of a candidate, signed")
def get_provenance(request: Request, parts: With, plant: PlantName, digest: DigestPath) -> Envelope:
    """An in-toto statement (test-result) in a DSSE envelope: candidate, gate, incumbent and held-out episodes by digest."""
    with parts.database.read() as connection:
        found = find.decision(Reader(connection), plant, digest)
    if digest_of(found.document) != digest:
        raise BrokenChain("the kept decision is not the one that its digest names", decision=digest)
    facts: dict[str, Json] = {name: getattr(found, name) for name in ("plant", "job", "created_at", "created_by")}
    return Envelope(**request.app.state.log.envelope(PAYLOAD_TYPE, of_decision(found.document, digest, facts)))


@router.get("/decisions/{digest}", summary="Get a decision by its digest alone")
def find_decision(parts: With, digest: DigestPath) -> Decision:
    with parts.database.read() as connection:
        return Decision.model_validate(find.any_decision(Reader(connection), digest))
