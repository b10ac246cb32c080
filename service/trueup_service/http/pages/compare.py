"""The page of two versions: what changed, and where the second is better or worse."""

from __future__ import annotations

import json
from typing import Annotated, Any

import orjson
from fastapi import Query, Request, Response
from starlette.concurrency import run_in_threadpool

from trueup.diagnose.number_text import short
from trueup.diagnose.summary_text import name
from trueup_pages.diagnosis import recordings_of
from trueup_service.actions import find
from trueup_service.actor_context import ActorContext
from trueup_service.http.dependencies import PlantName, RequestContext, RequestParts
from trueup_service.http.pages.page import begin_job, form, go, page_router, show
from trueup_service.registry.records import FINAL, ArtifactRecord, JobRecord
from trueup_service.registry.transaction import reading
from trueup_service.wiring import Parts

router = page_router()
COMPARISON = "comparison.json"
Version = Annotated[int, Query(ge=1, le=2**31 - 1)]
LISTED = 200  # versions to choose from, the newest


@router.get("/plants/{plant}/compare")
def compare(
    request: Request,
    parts: RequestParts,
    plant: PlantName,
    first: Version | None = None,
    second: Version | None = None,
) -> Response:
    """What changed, and the result of the newest comparison, if there is one; by default of what
    serves and the newest other version."""
    with reading(parts.database) as tx:
        serving, newest = find.serving(tx, plant).version, tx.artifacts.latest_version(plant)
        first = first or serving
        second = second or (newest if newest != first else max(newest - 1, 1))
        both = [find.version(tx, plant, v) for v in (first, second)]
        asked = [a.digest for a in both]
        job = tx.jobs.last_matching(
            plant,
            "compare",
            lambda r: [r["first"], r["second"]] == asked and len(r["episodes"]) > 1,
        )
        latest = tx.artifacts.latest_version(plant)
    values = {
        "plant": plant,
        "first": both[0],
        "second": both[1],
        "versions": range(max(1, latest - LISTED + 1), latest + 1),
        "changes": _changes(*both),
        **comparison(parts, job, both),
    }
    return show(request, "compare.html", 200, **values)


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


def _changes(first: ArtifactRecord, second: ArtifactRecord) -> list[dict[str, Any]]:
    """What differs between two versions, one row for each property."""
    summaries = [_summary(a) for a in (first, second)]
    rows = []
    for what in dict.fromkeys([*summaries[0], *summaries[1]]):
        pair = [t.get(what, "–") for t in summaries]
        rows.append(
            {"what": what, "first": pair[0], "second": pair[1], "differs": pair[0] != pair[1]}
        )
    return rows


def _summary(record: ArtifactRecord) -> dict[str, str]:
    manifest: dict[str, Any] = json.loads(record.manifest)
    predictor, provenance = manifest.get("predictor", {}), manifest.get("provenance", {})
    nominal = manifest["plant"]["document"]["nominal"].get("parameters", {})
    summary = {
        "kind": record.kind,
        "artifact": record.digest[:16],
        "made": record.created_at[:19].replace("T", " "),
        "by": record.created_by,
    }
    numbers = predictor.get("parameters") or nominal
    if isinstance(numbers, dict):
        summary |= {
            f"parameter {key}": short(value)
            for key, value in numbers.items()
            if isinstance(value, int | float)
        }
    for effect in predictor.get("effects", []):
        summary |= {
            f"{name(effect)}, {key}": short(value) for key, value in effect["parameters"].items()
        }
    if predictor.get("features"):
        summary["features"] = ", ".join(predictor["features"])
    summary["origin"] = str(
        provenance.get("origin")
        or provenance.get("configuration", {}).get("document", {}).get("method", "–")
    )
    summary["code"] = str(provenance.get("code", {}).get("sha256", "–"))[:16]
    read = provenance.get("configuration", {}).get("document", {}).get("episodes")
    summary["episodes"] = str(len(read)) if read else "–"
    return summary
