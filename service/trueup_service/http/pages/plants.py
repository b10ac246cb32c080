"""The page of all plants, one line each."""

from __future__ import annotations

from typing import Annotated

from fastapi import Query, Request, Response

from trueup_service.http.dependencies import RequestParts
from trueup_service.http.guard import CurrentPrincipal
from trueup_service.http.pages.page import page_router, show
from trueup_service.registry.overview import plant_lines
from trueup_service.registry.transaction import reading

router = page_router()
LINES = 50


@router.get("/")
def plants(
    request: Request,
    parts: RequestParts,
    principal: CurrentPrincipal,
    q: Annotated[str, Query(max_length=63)] = "",
    after: Annotated[str, Query(max_length=63)] = "",
) -> Response:
    """The plants that the token sees and whose name contains `q`, by name."""
    with reading(parts.database) as tx:
        lines = plant_lines(
            tx, after, LINES + 1, of=principal.plant, project=principal.project, containing=q
        )
    more = lines[LINES - 1].name if len(lines) > LINES else None
    return show(request, "plants.html", lines=lines[:LINES], q=q, after=after, more=more)
