"""The form by which a page gives something a name, tags and a note."""

from __future__ import annotations

from collections.abc import Mapping

from fastapi import Request, Response
from starlette.concurrency import run_in_threadpool

from trueup.errors import TrueupError
from trueup_service.actions.label import Change, label, label_of
from trueup_service.http.dependencies import PlantName, RequestContext, RequestParts
from trueup_service.http.pages.page import act, checked, form, own_path, page_router, show
from trueup_service.http.routers.labels import Subject
from trueup_service.http.schemas.labels import LabelChange
from trueup_service.registry.label_record import Labelled
from trueup_service.registry.transaction import reading

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
    """Change a label, and go back to the page of what is labelled; where the change is refused,
    show it again beside what the label is now."""
    fields = await form(request)
    back = own_path(fields.get("back", "/"))

    def change_it() -> object:
        wanted = _wanted(fields)
        return parts.writer.run(lambda tx: label(tx, plant, kind, subject, wanted, context))

    def again(refused: TrueupError) -> Response:
        with reading(parts.database) as tx:
            now = label_of(tx, plant, kind, subject)
        written = {name: fields.get(name, "") for name in ("name", "tags", "note")}
        return show(request, "label.html", refused=refused, label=now, fields=written, back=back)

    return await act(request, lambda: run_in_threadpool(change_it), again, back)


def _wanted(fields: Mapping[str, str]) -> Change:
    """The change that a form asks for. Raises BadRequest."""
    asked = checked(
        LabelChange.model_validate,
        {
            "name": fields.get("name", ""),
            "tags": [tag for tag in fields.get("tags", "").split(",") if tag.strip()],
            "note": fields.get("note", "").replace("\r\n", "\n"),
            "updated_at": fields.get("updated_at"),
        },
    )
    return Change(asked.name, asked.tags, asked.note, asked.updated_at)
