"""Routes of plants: register a machine by its plant.json, list, get."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import Body, Query, Response

from trueup_service.actions import find
from trueup_service.http.dependencies import (
    IdempotencyKey,
    Limit,
    PlantName,
    RequestContext,
    RequestParts,
    create,
)
from trueup_service.http.drafting import project_of_new_plant
from trueup_service.http.guard import CurrentPrincipal, guarded
from trueup_service.http.openapi import already_exists
from trueup_service.http.schemas.episodes import Plant
from trueup_service.http.schemas.wire import Page, page
from trueup_service.registry.transaction import reading

router = guarded("/v1/plants", ["plants"])


@router.post(
    "",
    status_code=201,
    response_model=Plant,
    summary="Register a plant",
    responses=already_exists(Plant),
)
def register(
    parts: RequestParts,
    context: RequestContext,
    principal: CurrentPrincipal,
    document: Annotated[dict[str, Any], Body(description="plant.json")],
    project: Annotated[
        str | None, Query(max_length=63, description="default: the token's own")
    ] = None,
    key: IdempotencyKey = None,
) -> Response:
    """The declared model becomes version 1 and serves at generation 1. The same description again
    responds 200.

    Names are unique over all projects. A name that another project has is refused without further
    information.
    """
    from trueup_service.actions.register_plant import register_plant  # noqa: PLC0415  (numpy: a server that only serves needs none)

    of = project_of_new_plant(principal, project)
    return create(
        parts,
        context,
        "plants",
        key,
        document,
        lambda tx: register_plant(tx, document, context, of),
        Plant,
    )


@router.get("", summary="List plants by name")
def list_plants(
    parts: RequestParts,
    principal: CurrentPrincipal,
    after: Annotated[str, Query(max_length=63)] = "",
    limit: Limit = 100,
) -> Page[Plant]:
    """The plants that the token sees."""
    with reading(parts.database) as tx:
        if principal.plant is not None:
            return Page(
                items=[Plant.model_validate(find.plant(tx, principal.plant))]
                if principal.plant > after
                else []
            )
        plants = tx.plants.page(after, limit, principal.project)
    return page(Plant, plants, limit, "name")


@router.get("/{plant}", summary="Get a plant")
def get_plant(parts: RequestParts, plant: PlantName) -> Plant:
    with reading(parts.database) as tx:
        return Plant.model_validate(find.plant(tx, plant))
