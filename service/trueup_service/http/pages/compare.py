"""The page of up to six versions: what differs, how they were judged over time, and of two where
the second is better or worse."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Annotated, Any

import orjson
from fastapi import Query, Request, Response
from starlette.concurrency import run_in_threadpool

from trueup_pages.diagnosis import recordings_of
from trueup_pages.versions import differences, judged, summary
from trueup_service.actions import find
from trueup_service.actor_context import ActorContext
from trueup_service.errors import BadRequest
from trueup_service.http.dependencies import PlantName, RequestContext, RequestParts
from trueup_service.http.pages.page import begin_job, form, go, page_router, show
from trueup_service.registry.label_record import Labelled
from trueup_service.registry.records import FINAL, ArtifactRecord, JobRecord
from trueup_service.registry.transaction import reading
from trueup_service.wiring import Parts

router = page_router()
COMPARISON = "comparison.json"
Version = Annotated[int, Query(ge=1, le=2**31 - 1)]
LISTED = 200  # versions to choose from, the newest
MOST = 6  # versions beside each other
COMPARED = 2  # versions, on recordings
DECISIONS = 200  # that are drawn, the newest
Versions = Annotated[Sequence[Version], Query(max_length=100)]


@router.get("/plants/{plant}/compare")
def compare(
    request: Request,
    parts: RequestParts,
    plant: PlantName,
    first: Version | None = None,
    second: Version | None = None,
    v: Versions = (),
) -> Response:
    """What differs between up to six versions, and how they were judged over time; of two, by
    default of what serves and the newest other version, also the newest comparison."""
    with reading(parts.database) as tx:
        serving, latest = find.serving(tx, plant).version, tx.artifacts.latest_version(plant)
        chosen = list(dict.fromkeys(v)) or _pair(first or serving, second, latest)
        if len(chosen) > MOST:
            raise BadRequest(
                f"{len(chosen)} versions are too many to compare",
                hint=f"Choose two to {MOST} of them.",
                field="v",
            )
        chosen = chosen if len(chosen) > 1 else _pair(chosen[0], None, latest)
        records = [find.version(tx, plant, n) for n in chosen]
        asked = [r.digest for r in records]
        compared = len(records) == COMPARED and tx.jobs.last_matching(
            plant,
            "compare",
            lambda r: [r["first"], r["second"]] == asked and len(r["episodes"]) > 1,
        )
        decisions = tx.decisions.between(plant, asked, DECISIONS)
        gates = {g: find.gate(tx, plant, g).document for g in {d.gate for d in decisions}}
        labels = tx.labels.names(plant, Labelled.VERSION, asked)
        named = {d for made in decisions for d in (made.candidate, made.incumbent)}
        numbers = tx.artifacts.numbers(plant, sorted({*asked, *named}))
    values: dict[str, Any] = {
        "plant": plant,
        "chosen": records,
        "called": labels,
        "versions": range(max(1, latest - LISTED + 1), latest + 1),
        "changes": differences([_described(r) for r in records]),
        "judged": judged(plant, decisions, {r.digest: r.version for r in records}, gates),
        "version_of": numbers,
        "most": DECISIONS if len(decisions) == DECISIONS else None,
    }
    if len(records) > COMPARED:
        return show(request, "compare_many.html", 200, **values)
    values |= {
        "first": records[0],
        "second": records[1],
        **comparison(parts, compared or None, records),
    }
    return show(request, "compare.html", 200, **values)


def _pair(first: int, second: int | None, newest: int) -> list[int]:
    """Two versions: one, and another that was asked for or is the newest other one."""
    return [first, second or (newest if newest != first else max(newest - 1, 1))]


@router.post("/plants/{plant}/compare")
async def begin(
    request: Request, parts: RequestParts, context: RequestContext, plant: PlantName
) -> Response:
    """Submit a comparison on the held-out episodes."""
    fields = await form(request)
    first, second = await run_in_threadpool(
        _begin, parts, context, plant, fields.get("first", ""), fields.get("second", "")
    )
    return go(f"/plants/{plant}/compare", first=str(first), second=str(second))


def _begin(
    parts: Parts, context: ActorContext, plant: str, first: str, second: str
) -> tuple[int, int]:
    with reading(parts.database) as tx:
        both = (find.artifact(tx, plant, first).version, find.artifact(tx, plant, second).version)
    begin_job(parts, context, plant, "compare", {"first": first, "second": second})
    return both


def comparison(parts: Parts, job: JobRecord | None, both: list[ArtifactRecord]) -> dict[str, Any]:
    """The values of a comparison's page: its result or its progress, and the values of
    `recordings.html`."""
    waiting = job is not None and job.state not in FINAL
    drawn = None
    if job is not None and not waiting:
        with reading(parts.database) as tx:
            output = tx.outputs.get(job.id, COMPARISON)
        drawn = orjson.loads(parts.blobs.get(output.digest)) if output is not None else None
    kinds = zip(("first", "second"), both, ("nominal", "corrected"), strict=True)
    models = [{"key": key, "label": f"version {a.version}", "kind": kind} for key, a, kind in kinds]
    problem = (job.result or {}).get("problem") if job is not None else None
    return {
        "job": job,
        "waiting": waiting,
        "problem": problem,
        "comparison": drawn,
        **recordings_of(drawn, models),
    }


def _described(record: ArtifactRecord) -> dict[str, str]:
    """A version in words."""
    return {
        "kind": record.kind,
        "artifact": record.digest[:16],
        "made": record.created_at[:19].replace("T", " "),
        "by": record.created_by,
        **summary(json.loads(record.manifest)),
    }
