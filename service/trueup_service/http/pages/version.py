"""The page of a version: what it is, what it was made from, how it was judged, and where it
serves."""

from __future__ import annotations

import json
from typing import Annotated, Any

from fastapi import Path, Request, Response

from trueup_pages.versions import summary
from trueup_service.actions import find
from trueup_service.actions.label import label_of
from trueup_service.http.dependencies import PlantName, RequestParts
from trueup_service.http.pages.page import page_router, show
from trueup_service.registry.label_record import Labelled
from trueup_service.registry.transaction import reading

router = page_router()
DECISIONS = 100  # that are listed, the newest
Number = Annotated[int, Path(ge=1, le=2**31 - 1, description="A version's number")]


@router.get("/plants/{plant}/versions/{version}")
def version(request: Request, parts: RequestParts, plant: PlantName, version: Number) -> Response:
    """A version, with the decisions that name it and the evidence at each stage."""
    with reading(parts.database) as tx:
        record = find.version(tx, plant, version)
        made = tx.decisions.between(plant, [record.digest], DECISIONS)
        digests = {digest for d in made for digest in (d.candidate, d.incumbent)}
        last = tx.evidence.last_by_stage(plant, record.digest)
        job = None if record.job is None else tx.jobs.get(record.job)
        values: dict[str, Any] = {
            "plant": plant,
            "artifact": record,
            "label": label_of(tx, plant, Labelled.VERSION, record.digest),
            "serving": find.serving(tx, plant),
            "summary": summary(json.loads(record.manifest)),
            "job": job,
            "decisions": made[::-1],
            "most": DECISIONS if len(made) == DECISIONS else None,
            "version_of": tx.artifacts.numbers(plant, sorted(digests)),
            "evidence": [tx.evidence.get(plant, digest) for digest, _ in last.values()],
            "gate": next(reversed(tx.gates.in_order(plant)), None),
        }
    return show(request, "version.html", **values)
