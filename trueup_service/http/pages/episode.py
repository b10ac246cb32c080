"""An episode: what was recorded under which conditions, what served meanwhile, and what it was used for."""

from __future__ import annotations

from fastapi import Request, Response

from trueup_service.actions import find
from trueup_service.http.context import DigestPath, PlantName, With
from trueup_service.http.guard import guarded
from trueup_service.http.pages.page import show
from trueup_service.http.routers.episodes import PURPOSES, served_during
from trueup_service.registry.store import Reader

router = guarded("", ["pages"])


@router.get("/plants/{plant}/episodes/{digest}")
def episode(request: Request, parts: With, plant: PlantName, digest: DigestPath) -> Response:
    with parts.database.read() as connection:
        reader = Reader(connection)
        found = find.episode(reader, plant, digest)
        uses = {purpose: reader.uses(digest, purpose) for purpose in PURPOSES}
        served = served_during(reader, found)
    return show(request, "episode.html", plant=plant, episode=found, uses={k: n for k, n in uses.items() if n}, served=served)
