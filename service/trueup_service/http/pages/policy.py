"""The page of a plant's update policy: what may happen to its model without a person, and the form
that declares it."""

from __future__ import annotations

from typing import Any

from fastapi import Request, Response
from starlette.concurrency import run_in_threadpool

from trueup.canonical import Json
from trueup.errors import TrueupError
from trueup.gate.policy import CHOICES, SCHEMA, BadPolicy
from trueup_service.actions import find
from trueup_service.actions.declare_policy import declare_policy
from trueup_service.actions.gate_line import place
from trueup_service.http.dependencies import PlantName, RequestContext, RequestParts
from trueup_service.http.guard import CurrentPrincipal
from trueup_service.http.pages.page import act, form, page_router, show
from trueup_service.registry.records import Role
from trueup_service.registry.transaction import reading
from trueup_service.wiring import Parts

router = page_router()
DEFAULTS: dict[str, Any] = {
    "on_alarm": "diagnose",
    "on_diagnosis": "judge",
    "on_acceptance": "ask",
    "on_rejected": "approval",
    "safeguards": "ask",
    "approvals": 1,
    "promise_h": 100.0,
    "reference_episodes": 20,
    "validate_every_h": None,
}
WHOLE, HOURS = ("approvals", "reference_episodes"), ("promise_h", "validate_every_h")


@router.get("/plants/{plant}/policy")
def policy(request: Request, parts: RequestParts, plant: PlantName) -> Response:
    """The policy that holds, and the form."""
    return _page(request, parts, plant)


@router.post("/plants/{plant}/policy")
async def declare(
    request: Request,
    parts: RequestParts,
    context: RequestContext,
    principal: CurrentPrincipal,
    plant: PlantName,
) -> Response:
    """Declare the policy of the form."""
    fields = await form(request)
    by_admin = Role.ADMIN in principal.roles

    def declared() -> object:
        document = _document(fields)
        return parts.writer.run(
            lambda tx: declare_policy(tx, plant, document, context, by_admin=by_admin)
        )

    return await act(
        request,
        lambda: run_in_threadpool(declared),
        lambda error: _page(request, parts, plant, error, fields),
        f"/plants/{plant}/policy",
    )


def _document(fields: dict[str, str]) -> dict[str, Json]:
    """The policy that a form declares. Raises BadPolicy."""
    document: dict[str, Json] = {"schema": SCHEMA, "gate": fields.get("gate", "")}
    for name, default in DEFAULTS.items():
        text = fields.get(name, "").strip()
        if not text:
            document[name] = default if name not in HOURS or name == "promise_h" else None
        elif name in CHOICES:
            document[name] = text
        else:
            try:
                document[name] = int(text) if name in WHOLE else float(text)
            except ValueError as error:
                raise BadPolicy(f"{name} must be a number, not {text!r}", field=name) from error
    return document


def _page(
    request: Request,
    parts: Parts,
    plant: str,
    refused: TrueupError | None = None,
    written: dict[str, str] | None = None,
) -> Response:
    with reading(parts.database) as tx:
        find.plant_digest(tx, plant)
        held, gate = tx.policies.in_force(plant), place(tx, plant)
    shown: dict[str, Any] = {**DEFAULTS, **(held.document if held else {}), **(written or {})}
    return show(
        request,
        "policy.html",
        plant=plant,
        held=held,
        gate=gate,
        shown=shown,
        choices=CHOICES,
        refused=refused,
    )
