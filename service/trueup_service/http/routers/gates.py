"""Routes of gates, the rules that are declared before anything is scored by them."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import Body, Query, Response

from trueup_service.actions import find
from trueup_service.actions.gate_line import Place, place
from trueup_service.errors import NotFound
from trueup_service.http.dependencies import (
    Digest,
    IdempotencyKey,
    Limit,
    PlantName,
    RequestContext,
    RequestParts,
    create,
)
from trueup_service.http.guard import guarded
from trueup_service.http.openapi import already_exists
from trueup_service.http.schemas.decisions import Gate, GateInLine, LooserThan
from trueup_service.http.schemas.wire import Page, page
from trueup_service.registry.transaction import reading

router = guarded("/v1/plants/{plant}", ["gates"])


@router.post(
    "/gates",
    status_code=201,
    response_model=Gate,
    summary="Declare a gate",
    responses=already_exists(Gate),
)
def declare(
    parts: RequestParts,
    context: RequestContext,
    plant: PlantName,
    document: Annotated[dict[str, Any] | None, Body()] = None,
    key: IdempotencyKey = None,
) -> Response:
    """Without a body it is the gate in force, or the default where there is none: rollout errors
    below 0.98 of the incumbent's, one-step errors no worse, over every window of the horizon. Once
    a candidate was judged, a new gate names the one in force in `follows` and gives a reason in
    `because`. A gate that cannot reject is refused, unless it declares itself `vacuous` with a
    reason."""
    from trueup_service.actions.declare_gate import declare_gate  # noqa: PLC0415  (numpy: a server that only serves needs none)

    return create(
        parts,
        context,
        f"gates/{plant}",
        key,
        document,
        lambda tx: declare_gate(tx, plant, document, context),
        Gate,
    )


@router.get("/gates", summary="List gates")
def list_gates(
    parts: RequestParts,
    plant: PlantName,
    after: Annotated[str, Query(max_length=64)] = "",
    limit: Limit = 100,
) -> Page[Gate]:
    with reading(parts.database) as tx:
        find.plant_digest(tx, plant)
        gates = tx.gates.page(plant, after, limit)
    return page(Gate, gates, limit, "digest")


@router.get("/gates/{digest}", summary="Get a gate")
def get_gate(parts: RequestParts, plant: PlantName, digest: Digest) -> Gate:
    with reading(parts.database) as tx:
        return Gate.model_validate(find.gate(tx, plant, digest))


@router.get("/gate", summary="Get the gate in force")
def get_gate_in_force(parts: RequestParts, plant: PlantName) -> GateInLine:
    """The last declared gate, which judges."""
    with reading(parts.database) as tx:
        find.plant_digest(tx, plant)
        in_force = place(tx, plant)
    if in_force is None:
        raise NotFound(
            f"plant {plant!r} has no gate",
            noun="gate",
            name=plant,
            hint="Declare one before anything is scored.",
        )
    return _in_line(in_force)


@router.get("/gates/{digest}/line", summary="Get a gate with its place in the plant's line")
def get_gate_in_line(parts: RequestParts, plant: PlantName, digest: Digest) -> GateInLine:
    """Whether the gate is in force, which gate was before it, and what is looser in it."""
    with reading(parts.database) as tx:
        gate = place(tx, plant, digest)
    if gate is None:
        raise find.not_found("gate", digest)
    return _in_line(gate)


def _in_line(gate: Place) -> GateInLine:
    return GateInLine(
        **Gate.model_validate(gate.gate).model_dump(),
        in_force=gate.in_force,
        follows=None if gate.before is None else gate.before.digest,
        looser=gate.looser,
        looser_than=[LooserThan.model_validate(less) for less in gate.looser_than],
    )
