"""Routes of update policies: what may happen to a plant's model without a person."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import Body, Query, Response

from trueup_service.actions import find
from trueup_service.actions.declare_policy import declare_policy
from trueup_service.errors import NotFound
from trueup_service.http.dependencies import (
    IdempotencyKey,
    Limit,
    PlantName,
    RequestContext,
    RequestParts,
    create,
)
from trueup_service.http.guard import CurrentPrincipal, guarded
from trueup_service.http.openapi import already_exists
from trueup_service.http.schemas.decisions import Policy
from trueup_service.http.schemas.wire import Page, page
from trueup_service.registry.records import PolicyRecord, Role
from trueup_service.registry.transaction import Transaction, reading

router = guarded("/v1/plants/{plant}", ["policies"])


@router.post(
    "/policies",
    status_code=201,
    response_model=Policy,
    summary="Declare an update policy",
    responses=already_exists(Policy),
)
def declare(
    parts: RequestParts,
    context: RequestContext,
    principal: CurrentPrincipal,
    plant: PlantName,
    document: Annotated[
        dict[str, Any],
        Body(description="A policy: schema, gate, on_alarm, on_diagnosis, on_acceptance, …"),
    ],
    key: IdempotencyKey = None,
) -> Response:
    """The policy is in force from now on, and earlier ones stay on record. Only an admin may let
    promotions take fewer people than before."""

    def act(tx: Transaction) -> tuple[PolicyRecord, bool]:
        return declare_policy(tx, plant, document, context, by_admin=Role.ADMIN in principal.roles)

    return create(parts, context, f"policies/{plant}", key, document, act, Policy)


@router.get("/policies", summary="List the policies that held, in order")
def list_policies(
    parts: RequestParts,
    plant: PlantName,
    after: Annotated[int, Query(ge=0, le=2**31 - 1, description="sequence")] = 0,
    limit: Limit = 100,
) -> Page[Policy]:
    with reading(parts.database) as tx:
        find.plant_digest(tx, plant)
        policies = tx.policies.page(plant, after, limit)
    return page(Policy, policies, limit, "sequence")


@router.get("/policy", summary="Get the policy that holds")
def get_policy(parts: RequestParts, plant: PlantName) -> Policy:
    with reading(parts.database) as tx:
        find.plant_digest(tx, plant)
        policy = tx.policies.in_force(plant)
    if policy is None:
        raise NotFound(
            f"plant {plant!r} has no policy",
            noun="policy",
            name=plant,
            hint="Declare one; until then every step is a person's.",
        )
    return Policy.model_validate(policy)
