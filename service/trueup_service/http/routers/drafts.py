"""Routes of drafts: files propose a plant with its episodes, somebody corrects it, and registers
it."""

from __future__ import annotations

from typing import Annotated

from fastapi import Body, Query, Request

from trueup_service.drafts import Draft as DraftOnDisk
from trueup_service.drafts import Drafts
from trueup_service.http.dependencies import Digest, RequestContext, RequestParts
from trueup_service.http.drafting import receive_draft, register_draft, revise_draft
from trueup_service.http.guard import CurrentPrincipal, guarded
from trueup_service.http.routers.episodes import RECORDING
from trueup_service.http.schemas.decisions import Gate
from trueup_service.http.schemas.drafts import Draft, DraftRegistration, Registered, Wishes
from trueup_service.http.schemas.episodes import Episode, Plant

router = guarded("/v1/drafts", ["plants"])


@router.post(
    "", status_code=201, summary="Propose a plant from recordings", openapi_extra=RECORDING
)
async def propose(
    request: Request,
    parts: RequestParts,
    principal: CurrentPrincipal,
    file: Annotated[
        str, Query(max_length=255, description="The file's name; its end says of which format")
    ] = "recording",
) -> Draft:
    """The body is a recording, or a zip archive of several, of a case folder, or of a recording
    with an MJCF or URDF. Signals are found by their names, a model is identified, and the last part
    is held out, as by `trueup init`. Nothing is registered yet. A draft is seen by its token alone,
    at the server that received it."""
    return _on_wire(await receive_draft(request, parts, principal, file, {}))


@router.get("/{draft}", summary="Get a draft")
def get(parts: RequestParts, principal: CurrentPrincipal, draft: Digest) -> Draft:
    return _on_wire(Drafts(parts.settings.data_dir).get(principal.token, draft))


@router.post("/{draft}/revise", summary="Make a draft again, under other wishes")
async def revise(
    request: Request,
    parts: RequestParts,
    principal: CurrentPrincipal,
    draft: Digest,
    wishes: Wishes,
) -> Draft:
    """The wishes take the place of all earlier ones. Where they are refused, the draft stays as it
    is."""
    wanted = wishes.model_dump(exclude_none=True)
    return _on_wire(await revise_draft(request, parts, principal, draft, wanted))


@router.post("/{draft}/register", status_code=201, summary="Register what a draft proposes")
async def register(
    request: Request,
    parts: RequestParts,
    context: RequestContext,
    principal: CurrentPrincipal,
    draft: Digest,
    wanted: Annotated[DraftRegistration | None, Body()] = None,
) -> Registered:
    """The plant, its episodes, and with `declare_gate` the default gate, declared before anything
    is scored. A request that broke off is sent again: what is registered already stays as it is."""
    made = await register_draft(
        request,
        parts,
        context,
        principal,
        draft,
        declares_gate=wanted is not None and wanted.declare_gate,
    )
    return Registered(
        plant=Plant.model_validate(made.plant.record),
        episodes=[Episode.model_validate(e.record) for e in made.episodes],
        gate=None if made.gate is None else Gate.model_validate(made.gate.record),
    )


def _on_wire(draft: DraftOnDisk) -> Draft:
    return Draft.model_validate(draft.document)
