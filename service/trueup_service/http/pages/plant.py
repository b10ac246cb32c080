"""The page of a plant: what serves and its history, the way back, and a diagnosis to start."""

from __future__ import annotations

import uuid
from datetime import UTC, datetime
from typing import Annotated, Any

from fastapi import Query, Request, Response
from starlette.concurrency import run_in_threadpool

from trueup.episode.role import STAGES
from trueup.errors import PointerMoved, TrueupError
from trueup.ledger.pointer import NothingToRollBackTo
from trueup_pages.jobs import name_of
from trueup_service.actions import find
from trueup_service.actions.gate_line import place
from trueup_service.actions.label import label_of
from trueup_service.actions.move_pointer import older_positions
from trueup_service.actions.promotion import rehearse_way_back, roll_back
from trueup_service.actor_context import END_OF_TIME, time_text
from trueup_service.http.dependencies import PlantName, RequestContext, RequestParts
from trueup_service.http.pages.next_step import next_step
from trueup_service.http.pages.page import act, begin_job, form, go, page_router, show, whole_number
from trueup_service.http.pages.study import STUDIES
from trueup_service.registry.label_record import Labelled
from trueup_service.registry.listing import Wanted, lines
from trueup_service.registry.overview import gaps_of
from trueup_service.registry.transaction import reading
from trueup_service.wiring import Parts

router = page_router()
ENTRIES, MOST_ENTRIES, ROWS = 300, 2000, 10
Moment = Annotated[str, Query(max_length=40, description="A time, ISO 8601")]
NO_END = 2**62
EARLIEST = datetime(1970, 1, 1, tzinfo=UTC)


@router.get("/plants/{plant}")
def plant_page(
    request: Request, parts: RequestParts, plant: PlantName, since: Moment = "", until: Moment = ""
) -> Response:
    """What serves, what happened of late or from one time to another, and the newest of
    everything."""
    window = _window(since, until)
    with reading(parts.database) as tx:
        record = find.plant(tx, plant)
        serving = find.serving(tx, plant)
        artifact = find.artifact(tx, plant, serving.artifact)
        back = None if serving.back_to is None else tx.serving.at_generation(plant, serving.back_to)
        last = tx.evidence.last_by_stage(plant, serving.artifact)
        jobs = tx.jobs.page(plant, END_OF_TIME, ROWS * 3)
        latest = tx.artifacts.latest_version(plant)
        policy = tx.policies.in_force(plant)
        versions = list(reversed(tx.artifacts.page(plant, max(latest - ROWS, 0), ROWS)))
        newest, episode_count = lines(tx, plant, Labelled.EPISODE, Wanted("-uploaded"), ROWS)
        values: dict[str, Any] = {
            "plant": record,
            "label": label_of(tx, plant, Labelled.PLANT, plant),
            "serving": serving,
            "artifact": artifact,
            "back": back,
            "alarm": tx.alarms.open(plant),
            "policy": policy,
            "policy_gate": None
            if policy is None
            else place(tx, plant, str(policy.document["gate"])),
            "gap": gaps_of(tx, [plant]).get(plant, ()),
            "ladder": [
                (stage, stage in last and tx.evidence.get(plant, last[stage][0]))
                for stage in STAGES
            ],
            "decisions": tx.decisions.page(plant, END_OF_TIME, ROWS),
            "versions": versions,
            "version_of": {v.digest: f"version {v.version}" for v in versions},
            "step": next_step(tx, plant, serving),
            "gate": next(reversed(tx.gates.in_order(plant)), None),
            "studies": [j for j in jobs if j.kind in (*STUDIES, "blindtrial")][:ROWS],
            "job_name": name_of,
            "study_names": {kind: of.name for kind, of in STUDIES.items() if of.request},
            "diagnoses": [j for j in jobs if j.kind == "diagnose"][:ROWS],
            "called": tx.labels.names(plant, Labelled.VERSION, [v.digest for v in versions]),
            "episodes": newest,
            "episode_count": episode_count,
            "window": window,
            "entries": tx.log.newest_entries(NO_END, ENTRIES, plant=plant)
            if window is None
            else tx.log.entries_between(plant, *window, MOST_ENTRIES),
            "most": MOST_ENTRIES,
        }
    return show(request, "plant.html", **values)


def _window(since: str, until: str) -> tuple[str, str] | None:
    """The stretch of time that an address asks for, in UTC where it names no zone; None where it
    asks for none, or makes no sense."""
    try:
        both = [datetime.fromisoformat(at) for at in (since, until)]
        both = [(at if at.tzinfo else at.replace(tzinfo=UTC)).astimezone(UTC) for at in both]
    except (ValueError, OverflowError):
        return None
    first, last = (max(at, EARLIEST) for at in both)
    return (time_text(first), time_text(last)) if first < last else None


@router.post("/plants/{plant}/diagnoses")
def diagnose(parts: RequestParts, context: RequestContext, plant: PlantName) -> Response:
    """Submit a diagnosis, and go to its page."""
    job = begin_job(parts, context, plant, "diagnose", {"seed": 0})
    return go(f"/plants/{plant}/diagnoses/{job}")


@router.get("/plants/{plant}/rollback")
def rollback_page(request: Request, parts: RequestParts, plant: PlantName) -> Response:
    """What a rollback would do. The switchback test runs now, and the pointer moves only when the
    form is sent."""
    return _offer(request, parts, plant, None)


@router.post("/plants/{plant}/rollback")
async def rollback(
    request: Request, parts: RequestParts, context: RequestContext, plant: PlantName
) -> Response:
    """Roll the pointer back, if it is at the generation that the form was shown for."""
    fields = await form(request)
    generation, to = (whole_number(fields.get(name, "")) for name in ("generation", "to"))

    async def move() -> None:
        older = to if fields.get("to") else None
        key = fields.get("key") or None
        await run_in_threadpool(roll_back, parts, context, plant, generation, key, older)
        request.app.state.answers.wake()

    return await act(
        request, move, lambda error: _offer(request, parts, plant, error), f"/plants/{plant}"
    )


def _offer(request: Request, parts: Parts, plant: str, refused: TrueupError | None) -> Response:
    with reading(parts.database) as tx:
        serving = find.serving(tx, plant)
        try:
            older = older_positions(tx, plant, serving.generation)
        except NothingToRollBackTo:
            older = []
    back = older[0].position if older else None
    tested, fails, instead = None, None, None
    if back is not None:
        try:
            tested = rehearse_way_back(parts, plant, serving.generation)
        except PointerMoved:
            pass  # the pointer moved meanwhile; sending the form will report it
        except TrueupError as error:
            fails, instead = error, error.facts.get("next")
    values: dict[str, Any] = {
        "name": plant,
        "serving": serving,
        "back": back,
        "tested": tested,
        "fails": fails,
        "instead": instead,
        "refused": refused,
    }
    return show(
        request,
        "rollback.html",
        key=uuid.uuid4().hex,
        **values,
    )
