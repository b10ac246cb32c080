"""The page of an episode: what was recorded under which conditions, what served meanwhile, what it
was used for, and how models predict it."""

from __future__ import annotations

import json
from typing import Annotated, Any

from fastapi import Query, Request, Response

from trueup_pages.foxglove import layout
from trueup_service.actions import find
from trueup_service.actions.label import label_of
from trueup_service.http.dependencies import Digest, PlantName, RequestContext, RequestParts
from trueup_service.http.pages.compare import comparison
from trueup_service.http.pages.page import begin_job, go, page_router, show
from trueup_service.registry.label_record import Labelled
from trueup_service.registry.transaction import ReadTransaction, reading

router = page_router()
DECLARED = 1  # the version that every plant begins with
Version = Annotated[int, Query(ge=1, le=2**31 - 1)]


@router.get("/plants/{plant}/episodes/{digest}")
def episode(request: Request, parts: RequestParts, plant: PlantName, digest: Digest) -> Response:
    """An episode, with the newest comparison on it."""
    with reading(parts.database) as tx:
        record = find.episode(tx, plant, digest)
        serving = find.serving(tx, plant)
        job = tx.jobs.last_matching(plant, "compare", lambda r: r["episodes"] == [digest])
        asked: Any = (
            job.request
            if job is not None
            else {"first": serving.artifact, "second": serving.artifact}
        )
        both = [find.artifact(tx, plant, asked[which]) for which in ("first", "second")]
        values: dict[str, Any] = {
            "plant": plant,
            "episode": record,
            "label": label_of(tx, plant, Labelled.EPISODE, digest),
            "uses": {purpose: count for purpose, count in find.uses(tx, digest).items() if count},
            "served": find.served_during(tx, record),
            "serving": serving,
            "beside": _beside(tx, plant),
        }
    return show(request, "episode.html", 200, **values, **comparison(parts, job, both))


@router.post("/plants/{plant}/episodes/{digest}/signals")
def look(
    parts: RequestParts, context: RequestContext, plant: PlantName, digest: Digest
) -> Response:
    """Submit a comparison of two versions on the episode."""
    with reading(parts.database) as tx:
        find.episode(tx, plant, digest)
        asked: dict[str, Any] = {
            "first": find.version(tx, plant, DECLARED).digest,
            "second": find.version(tx, plant, _beside(tx, plant)).digest,
            "episodes": [digest],
        }
    begin_job(parts, context, plant, "compare", asked)
    return go(f"/plants/{plant}/episodes/{digest}")


def _beside(tx: ReadTransaction, plant: str) -> int:
    """The version shown beside the declared one: the one that serves, or the newest where that is
    the declared one."""
    serving = find.serving(tx, plant).version
    return serving if serving != DECLARED else tx.artifacts.latest_version(plant)


@router.get("/plants/{plant}/foxglove.json")
def foxglove(parts: RequestParts, plant: PlantName, first: Version, second: Version) -> Response:
    """A Foxglove layout for the overlay of two versions."""
    with reading(parts.database) as tx:
        document = find.plant(tx, plant).document
    made = layout(document, [f"v{v}" for v in dict.fromkeys((first, second))])
    headers = {"Content-Disposition": f'attachment; filename="trueup-{plant}.json"'}
    return Response(json.dumps(made, indent=1), media_type="application/json", headers=headers)
