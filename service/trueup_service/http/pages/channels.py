"""The page of a plant's channels of serving: what each serves and requires, and the forms that
declare one and release a version to it."""

from __future__ import annotations

from collections.abc import Callable

from fastapi import Request, Response
from starlette.concurrency import run_in_threadpool

from trueup.episode.role import STAGES
from trueup.errors import TrueupError
from trueup_service.actions import find
from trueup_service.actions.channels import declare_channel, move_channel
from trueup_service.http.dependencies import PlantName, RequestContext, RequestParts
from trueup_service.http.pages.page import act, checked, form, page_router, show, whole_number
from trueup_service.http.routers.channels import ChannelName
from trueup_service.http.schemas.serving import ChannelDeclaration
from trueup_service.registry.transaction import Transaction, reading
from trueup_service.wiring import Parts

router = page_router()
LISTED = 100


@router.get("/plants/{plant}/channels")
def channels(request: Request, parts: RequestParts, plant: PlantName) -> Response:
    """What each channel serves and requires."""
    return _page(request, parts, plant)


@router.post("/plants/{plant}/channels")
async def declare(
    request: Request, parts: RequestParts, context: RequestContext, plant: PlantName
) -> Response:
    """Declare a channel."""
    fields = await form(request)
    requires = [stage for stage in STAGES if fields.get(f"requires-{stage}")]
    values = {"name": fields.get("name", "").strip(), "requires": requires}

    def declared() -> object:
        wanted = checked(ChannelDeclaration.model_validate, values)
        return parts.writer.run(
            lambda tx: declare_channel(tx, plant, wanted.name, wanted.requires, context)
        )

    return await _acted(request, parts, plant, declared)


@router.post("/plants/{plant}/channels/{channel}/move")
async def move(
    request: Request,
    parts: RequestParts,
    context: RequestContext,
    plant: PlantName,
    channel: ChannelName,
) -> Response:
    """Release a version to a channel, if the channel is where the form showed it."""
    fields = await form(request)
    version, generation = (whole_number(fields.get(n, "")) for n in ("version", "generation"))

    def moved(tx: Transaction) -> object:
        artifact = find.version(tx, plant, version).digest
        return move_channel(tx, plant, channel, artifact, generation, context)

    answer = await _acted(request, parts, plant, lambda: parts.writer.run(moved))
    request.app.state.answers.wake()
    return answer


async def _acted(
    request: Request, parts: Parts, plant: str, action: Callable[[], object]
) -> Response:
    return await act(
        request,
        lambda: run_in_threadpool(action),
        lambda error: _page(request, parts, plant, error),
        f"/plants/{plant}/channels",
    )


def _page(
    request: Request, parts: Parts, plant: str, refused: TrueupError | None = None
) -> Response:
    with reading(parts.database) as tx:
        serving = find.serving(tx, plant)
        listed = [
            (channel, tx.channel_moves.last(plant, channel.name))
            for channel in tx.channels.page(plant, "", LISTED)
        ]
        served = sorted({m.version for m in tx.serving.history(plant, 0, LISTED * 10)})
        last = tx.evidence.last_by_stage(plant, serving.artifact)
    return show(
        request,
        "channels.html",
        plant=plant,
        serving=serving,
        channels=listed,
        served=served,
        passed=[stage for stage in STAGES if stage in last and last[stage][1]],
        stages=STAGES,
        refused=refused,
    )
