"""The page on which recordings of a plant are dropped."""

from __future__ import annotations

from fastapi import Request, Response

from trueup.episode.role import STAGES, Role
from trueup_service.actions import find
from trueup_service.http.dependencies import PlantName, RequestParts
from trueup_service.http.pages.page import page_router, show
from trueup_service.registry.transaction import reading

router = page_router()
PURPOSES = {
    Role.ADAPTATION: "models are fitted on it",
    Role.VALIDATION: "held out: it compares and measures, and is never fitted",
    Role.TEST: "held out for studies",
    Role.REFERENCE: "healthy operation, on which a monitor is calibrated",
    Role.RETAINED: "earlier conditions, in which a candidate must not be worse",
    Role.TRAINING: "a plant of a family",
    Role.TELEMETRY: "everyday operation, which a monitor watches",
}


@router.get("/plants/{plant}/upload")
def upload(request: Request, parts: RequestParts, plant: PlantName) -> Response:
    """Where recordings are dropped."""
    with reading(parts.database) as tx:
        find.plant_digest(tx, plant)
    return show(request, "upload.html", plant=plant, purposes=PURPOSES, stages=STAGES)
