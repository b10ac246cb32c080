"""The page of a plant's gate: the rules in force and those before, and the form that declares
others."""

from __future__ import annotations

import json
from typing import Any

import orjson
from fastapi import Request, Response
from starlette.concurrency import run_in_threadpool

from trueup.canonical import Json
from trueup.errors import BadGate, TrueupError
from trueup_service.actions import find
from trueup_service.actions.gate_line import place
from trueup_service.http.dependencies import PlantName, RequestContext, RequestParts
from trueup_service.http.pages.page import act, form, page_router, show
from trueup_service.registry.transaction import reading
from trueup_service.wiring import Parts

router = page_router()


@router.get("/plants/{plant}/gate")
def gate(request: Request, parts: RequestParts, plant: PlantName) -> Response:
    """The gate in force, the gates before it, and the form."""
    return _page(request, parts, plant)


@router.post("/plants/{plant}/gate")
async def declare(
    request: Request, parts: RequestParts, context: RequestContext, plant: PlantName
) -> Response:
    """Declare the default gate, or the rules that were written."""
    from trueup_service.actions.declare_gate import declare_gate  # noqa: PLC0415  (numpy)

    fields = await form(request)

    def declared() -> object:
        document = _document(fields)
        return parts.writer.run(lambda tx: declare_gate(tx, plant, document, context))

    return await act(
        request,
        lambda: run_in_threadpool(declared),
        lambda error: _page(request, parts, plant, error, fields.get("document")),
        f"/plants/{plant}" if fields.get("default") else f"/plants/{plant}/gate",
    )


def _document(fields: dict[str, str]) -> dict[str, Json] | None:
    """The gate that a form declares, None for the default. Raises BadGate."""
    if fields.get("default"):
        return None
    try:
        document = orjson.loads(fields.get("document", ""))
    except orjson.JSONDecodeError as error:
        raise BadGate(f"the rules are not JSON: {error}", field="document") from error
    if not isinstance(document, dict):
        raise BadGate("a gate is an object", field="document")
    for name in ("follows", "because"):
        document.pop(name, None)
        if fields.get(name, "").strip():
            document[name] = fields[name].strip()
    if "because" not in document:
        document.pop("follows", None)  # the refusal says what both are for
    return document


def _page(
    request: Request,
    parts: Parts,
    plant: str,
    refused: TrueupError | None = None,
    written: str | None = None,
) -> Response:
    with reading(parts.database) as tx:
        registered: Any = find.plant(tx, plant)
        now, line = place(tx, plant), tx.gates.in_order(plant)
    rules = dict(now.gate.document) if now else _default(registered.document)
    for name in ("follows", "because"):
        rules.pop(name, None)
    return show(
        request,
        "gate.html",
        plant=plant,
        now=now,
        earlier=list(reversed(line[:-1])),
        written=written or json.dumps(rules, indent=1, ensure_ascii=False),
        refused=refused,
    )


def _default(document: dict[str, Json]) -> dict[str, Any]:
    from trueup.gate.decision import default_gate  # noqa: PLC0415  (numpy)
    from trueup.model.plant import Plant  # noqa: PLC0415  (numpy)

    return dict(default_gate(Plant.from_document(document).horizon_s).document())
