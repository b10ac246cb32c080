"""Audit: the append-only log of everything that was done."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Query

from trueup_service.http.context import Limit, With
from trueup_service.http.schemas import AuditEntry, AuditHead, Page, page
from trueup_service.registry.store import Reader

router = APIRouter(prefix="/v1/audit", tags=["audit"])


@router.get("", summary="List entries in order")
def list_entries(
    parts: With, plant: str | None = None, after: Annotated[int, Query(ge=0, le=2**62, description="sequence")] = 0, limit: Limit = 100
) -> Page[AuditEntry]:
    """Each entry's digest covers the one before it; filtered by plant they no longer form a chain."""
    with parts.database.read() as connection:
        found = Reader(connection).audit_entries(after, limit, plant)
    return page(AuditEntry, found, limit, "sequence")


@router.get("/head", summary="The last entry's sequence and digest")
def head(parts: With) -> AuditHead:
    with parts.database.read() as connection:
        sequence, digest = Reader(connection).audit_head()
    return AuditHead(sequence=sequence, digest=digest)
