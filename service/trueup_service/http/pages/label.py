"""The form by which a page gives something a name, tags and a note."""

from __future__ import annotations

from fastapi import Request, Response
from starlette.concurrency import run_in_threadpool

from trueup_service.actions.label import Change, label
from trueup_service.http.dependencies import PlantName, RequestContext, RequestParts
from trueup_service.http.pages.page import checked, form, go, own_path, page_router
from trueup_service.http.routers.labels import Subject
from trueup_service.http.schemas.labels import LabelChange
from trueup_service.registry.label_record import Labelled

router = page_router()


@router.post("/plants/{plant}/labels/{kind}/{subject}")
async def change(
    request: Request,
    parts: RequestParts,
    context: RequestContext,
    plant: PlantName,
    kind: Labelled,
    subject: Subject,
) -> Response:
    """Change a label, and go back to the page of what is labelled."""
    fields = await form(request)
    asked = checked(
        LabelChange.model_validate,
        {
            "name": fields.get("name", ""),
            "tags": [tag for tag in fields.get("tags", "").split(",") if tag.strip()],
            "note": fields.get("note", "").replace("\r\n", "\n"),
        },
    )
    wanted = Change(asked.name, asked.tags, asked.note)
    await run_in_threadpool(
        parts.writer.run, lambda tx: label(tx, plant, kind, subject, wanted, context)
    )
    return go(own_path(fields.get("back", "/")))
