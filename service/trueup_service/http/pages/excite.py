"""The page on which an experiment is designed: a bounded excitation of the machine."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from fastapi import Request, Response
from starlette.concurrency import run_in_threadpool

from trueup.episode.role import Role
from trueup.errors import TrueupError
from trueup_service.actions import find
from trueup_service.actor_context import END_OF_TIME
from trueup_service.errors import BadRequest
from trueup_service.http.dependencies import PlantName, RequestContext, RequestParts
from trueup_service.http.pages.page import (
    begin_job,
    checked,
    form,
    go,
    page_router,
    show,
    wants_page,
)
from trueup_service.http.schemas.jobs import ExcitationRequest
from trueup_service.registry.transaction import reading
from trueup_service.wiring import Parts

router = page_router()
JOBS, LISTED = 100, 10  # newest jobs that are looked through, and designs that are listed
PER_CENT = 100.0


@router.get("/plants/{plant}/excite")
def excite_page(request: Request, parts: RequestParts, plant: PlantName) -> Response:
    """What the command is for, and within which bounds."""
    return _page(request, parts, plant, {})


@router.post("/plants/{plant}/excite")
async def excite(
    request: Request, parts: RequestParts, context: RequestContext, plant: PlantName
) -> Response:
    """Submit the design of an excitation, and go to its page."""
    fields = await form(request)

    def submit() -> str:
        return begin_job(parts, context, plant, "excite", _asked(fields))

    try:
        job = await run_in_threadpool(submit)
    except TrueupError as error:
        if not wants_page(request):
            raise
        return await run_in_threadpool(_page, request, parts, plant, fields, error)
    return go(f"/plants/{plant}/studies/{job}")


def _asked(fields: Mapping[str, str]) -> dict[str, Any]:
    """The request that a form makes. Raises BadRequest."""
    declared = fields.get("model") == "declared"
    band = [_number(fields, name) for name in ("from_hz", "to_hz")]
    if (band[0] is None) != (band[1] is None):
        raise BadRequest(
            "a band has two ends", hint="Fill in both frequencies, or none.", field="from_hz"
        )
    spread, margin = (_number(fields, name) for name in ("spread", "margin"))
    asked = {
        "goal": fields.get("goal", "identify"),
        "spread": ((30.0 if spread is None else spread) / PER_CENT) if declared else None,
        "band_hz": None if band[0] is None else band,
        "margin": None if margin is None else margin / PER_CENT,
        **{name: _number(fields, name) for name in ("duration_s", "rate", "speed")},
    }
    given = {name: value for name, value in asked.items() if value is not None}
    request = checked(ExcitationRequest.model_validate, {"kind": "excite", **given})
    return request.model_dump(exclude={"kind"}, exclude_none=True, mode="json")


def _number(fields: Mapping[str, str], name: str) -> float | None:
    """A number of a form, None where its field is empty. Raises BadRequest."""
    text = fields.get(name, "").strip()
    try:
        return float(text) if text else None
    except ValueError as error:
        raise BadRequest(
            f"{name}: {text!r} is not a number", hint="Correct this field.", field=name
        ) from error


def _page(
    request: Request,
    parts: Parts,
    plant: str,
    shown: Mapping[str, str],
    refused: TrueupError | None = None,
) -> Response:
    with reading(parts.database) as tx:
        find.plant_digest(tx, plant)
        jobs = tx.jobs.page(plant, END_OF_TIME, JOBS)
        values: dict[str, Any] = {
            "plant": plant,
            "shown": shown,
            "diagnosis": tx.jobs.last_succeeded(plant, "diagnose"),
            "episodes": tx.episodes.count_of_role(plant, Role.ADAPTATION),
            "designs": [j for j in jobs if j.kind == "excite"][:LISTED],
        }
    return show(request, "excite.html", refused=refused, **values)
