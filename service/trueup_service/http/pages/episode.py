"""An episode: what was recorded under which conditions, what served meanwhile, what it was used
for, and what models say of it."""

from __future__ import annotations

import json
import uuid
from typing import Annotated, Any

from fastapi import Query, Request, Response

from trueup_pages.foxglove import layout
from trueup_service.actions import find
from trueup_service.actions.submit_job import SUBMIT
from trueup_service.http.context import By, DigestPath, PlantName, With
from trueup_service.http.guard import guarded
from trueup_service.http.pages.compare import comparison
from trueup_service.http.pages.page import go, show
from trueup_service.registry.overview import newest_job
from trueup_service.registry.store import Reader, writing

router = guarded("", ["pages"])
DECLARED = 1  # the version that every plant begins with
Version = Annotated[int, Query(ge=1, le=2**31 - 1)]


@router.get("/plants/{plant}/episodes/{digest}")
def episode(request: Request, parts: With, plant: PlantName, digest: DigestPath) -> Response:
    """What was recorded, and what the newest look at it left behind."""
    with parts.database.read() as connection:
        reader = Reader(connection)
        found = find.episode(reader, plant, digest)
        serving = find.serving(reader, plant)
        job = newest_job(connection, plant, "compare", lambda r: r["episodes"] == [digest])
        asked: Any = (
            job.request
            if job is not None
            else {"first": serving.artifact, "second": serving.artifact}
        )
        both = [find.artifact(reader, plant, asked[which]) for which in ("first", "second")]
        values: dict[str, Any] = {
            "plant": plant,
            "episode": found,
            "uses": {
                purpose: count for purpose, count in find.uses(reader, digest).items() if count
            },
            "served": find.served_during(reader, found),
            "serving": serving,
            "beside": _beside(reader, plant),
        }
    return show(request, "episode.html", 200, **values, **comparison(parts, job, both))


@router.post("/plants/{plant}/episodes/{digest}/signals")
def look(parts: With, stamp: By, plant: PlantName, digest: DigestPath) -> Response:
    """Roll two versions out over the episode."""
    parts.queue.prepare()
    with writing(parts.database) as writer:
        find.episode(writer, plant, digest)
        asked: dict[str, Any] = {
            "first": find.version(writer, plant, DECLARED).digest,
            "second": find.version(writer, plant, _beside(writer, plant)).digest,
            "episodes": [digest],
        }
        SUBMIT["compare"](writer, parts.queue, uuid.uuid4().hex, plant, asked, stamp)
    return go(f"/plants/{plant}/episodes/{digest}")


def _beside(reader: Reader, plant: str) -> int:
    """The version that is shown beside the declared one: what serves, or the newest while that is
    the declared one."""
    serving = find.serving(reader, plant).version
    return serving if serving != DECLARED else reader.latest_version(plant)


@router.get("/plants/{plant}/foxglove.json")
def foxglove(parts: With, plant: PlantName, first: Version, second: Version) -> Response:
    """A layout for the overlay of two versions."""
    with parts.database.read() as connection:
        document = find.plant(Reader(connection), plant).document
    made = layout(document, [f"v{v}" for v in dict.fromkeys((first, second))])
    headers = {"Content-Disposition": f'attachment; filename="trueup-{plant}.json"'}
    return Response(json.dumps(made, indent=1), media_type="application/json", headers=headers)
