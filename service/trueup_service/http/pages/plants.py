"""The page of all plants, one line each."""

from __future__ import annotations

from typing import Annotated

from fastapi import Query, Request, Response

from trueup_service.actions.label import MOST_OF_TAG, tag_as_kept
from trueup_service.http.dependencies import RequestParts
from trueup_service.http.guard import CurrentPrincipal
from trueup_service.http.pages.page import page_router, show
from trueup_service.registry.overview import plant_lines
from trueup_service.registry.transaction import reading

router = page_router()
LINES = 50
OPEN = "open"  # the alarms to which the page is filtered


@router.get("/")
def plants(
    request: Request,
    parts: RequestParts,
    principal: CurrentPrincipal,
    q: Annotated[str, Query(max_length=63)] = "",
    tag: Annotated[str, Query(max_length=MOST_OF_TAG)] = "",
    alarm: Annotated[str, Query(max_length=4)] = "",
    after: Annotated[str, Query(max_length=63)] = "",
) -> Response:
    """The plants that the token sees, by name: those whose name contains `q`, that have a tag, or
    whose alarm is open."""
    with reading(parts.database) as tx:
        lines = plant_lines(
            tx,
            after,
            LINES + 1,
            of=principal.plant,
            project=principal.project,
            containing=q.strip(),
            tag=tag_as_kept(tag),
            alarmed=alarm == OPEN,
        )
    more = lines[LINES - 1].name if len(lines) > LINES else None
    asked = {k: v for k, v in (("q", q), ("tag", tag), ("alarm", alarm)) if v}
    return show(
        request,
        "plants.html",
        lines=lines[:LINES],
        q=q,
        tag=tag,
        alarm=alarm,
        asked=asked,
        after=after,
        more=more,
    )
