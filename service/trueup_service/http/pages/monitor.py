"""The page of a plant's monitor: whether the model that serves is watched, what was seen, the
alarms, and the forms that calibrate a monitor and close an alarm."""

from __future__ import annotations

from typing import Any

from fastapi import Request, Response
from starlette.concurrency import run_in_threadpool

from trueup.errors import TrueupError
from trueup_service.actions import find
from trueup_service.actions.alarms import close_alarm
from trueup_service.actor_context import END_OF_TIME
from trueup_service.http.dependencies import PlantName, RequestContext, RequestParts
from trueup_service.http.pages.page import act, checked, form, page_router, show
from trueup_service.http.routers.monitors import AlarmId
from trueup_service.http.schemas.monitors import Closing
from trueup_service.registry.overview import gaps_of
from trueup_service.registry.transaction import reading
from trueup_service.wiring import Parts

router = page_router()
LISTED, SEEN = 20, 40


@router.get("/plants/{plant}/monitor")
def monitor(request: Request, parts: RequestParts, plant: PlantName) -> Response:
    """Whether the model that serves is watched, what was seen, and the alarms."""
    return _page(request, parts, plant)


@router.post("/plants/{plant}/alarms/{alarm}/close")
async def close(
    request: Request,
    parts: RequestParts,
    context: RequestContext,
    plant: PlantName,
    alarm: AlarmId,
) -> Response:
    """Close an alarm, with the reason of the form."""
    fields = await form(request)

    def closed() -> object:
        because = checked(Closing.model_validate, {"because": fields.get("because", "")}).because
        return parts.writer.run(lambda tx: close_alarm(tx, plant, alarm, because, context))

    return await act(
        request,
        lambda: run_in_threadpool(closed),
        lambda error: _page(request, parts, plant, error),
        f"/plants/{plant}/monitor",
    )


def _page(
    request: Request, parts: Parts, plant: str, refused: TrueupError | None = None
) -> Response:
    with reading(parts.database) as tx:
        serving = find.serving(tx, plant)
        watching = tx.watches.current(plant)
        of = None if watching is None else tx.monitors.get(plant, watching.monitor)
        seen = 0 if watching is None else watching.sequence
        values: dict[str, Any] = {
            "serving": serving,
            "monitor": of,
            "watches": of is not None and of.artifact == serving.artifact,
            "seen": seen,
            "watched": []
            if of is None
            else tx.watches.page(plant, of.digest, max(seen - SEEN, 0), SEEN),
            "gap": gaps_of(tx, [plant]).get(plant, ()),
            "alarms": tx.alarms.page(plant, END_OF_TIME, LISTED),
            "reference": len(tx.episodes.of_roles(plant, ("reference",))),
        }
    return show(request, "monitor.html", plant=plant, refused=refused, **values)
