"""Routes of decisions, with every figure, and of their approvals."""

from __future__ import annotations

from typing import Annotated

from fastapi import Body, Request, Response

from trueup.canonical import Json, digest_of
from trueup.errors import BrokenChain
from trueup.ledger.provenance import PAYLOAD_TYPE, of_decision
from trueup_service.actions import find
from trueup_service.actions.approve import approve
from trueup_service.actor_context import END_OF_TIME
from trueup_service.http.dependencies import (
    BeforeTime,
    Digest,
    IdempotencyKey,
    Limit,
    PlantName,
    RequestContext,
    RequestParts,
    create,
)
from trueup_service.http.guard import CurrentPrincipal, guarded, require_visible
from trueup_service.http.openapi import already_exists
from trueup_service.http.schemas.decisions import Approval, ApprovalRequest, Decision
from trueup_service.http.schemas.wire import Envelope, Page, page
from trueup_service.registry.transaction import reading

router = guarded("/v1", ["decisions"])


@router.get("/plants/{plant}/decisions", summary="List decisions, the newest first")
def list_decisions(
    parts: RequestParts, plant: PlantName, before: BeforeTime = END_OF_TIME, limit: Limit = 100
) -> Page[Decision]:
    with reading(parts.database) as tx:
        find.plant_digest(tx, plant)
        decisions = tx.decisions.page(plant, before, limit)
    return page(Decision, decisions, limit, "created_at")


@router.get("/plants/{plant}/decisions/{digest}", summary="Get a decision of a plant")
def get_decision(parts: RequestParts, plant: PlantName, digest: Digest) -> Decision:
    with reading(parts.database) as tx:
        return Decision.model_validate(find.decision(tx, plant, digest))


@router.get(
    "/plants/{plant}/decisions/{digest}/provenance",
    summary="What a gate said of a candidate, signed",
)
def get_provenance(
    request: Request, parts: RequestParts, plant: PlantName, digest: Digest
) -> Envelope:
    """An in-toto statement (test-result) in a DSSE envelope: candidate, gate, incumbent and
    held-out episodes by digest."""
    with reading(parts.database) as tx:
        decision = find.decision(tx, plant, digest)
    if digest_of(decision.document) != digest:
        raise BrokenChain("the kept decision is not the one that its digest names", decision=digest)
    facts: dict[str, Json] = {
        name: getattr(decision, name) for name in ("plant", "job", "created_at", "created_by")
    }
    return Envelope(
        **request.app.state.log.envelope(
            PAYLOAD_TYPE, of_decision(decision.document, digest, facts)
        )
    )


@router.post(
    "/plants/{plant}/decisions/{digest}/approvals",
    status_code=201,
    response_model=Approval,
    summary="Approve a decision for promotion",
    responses=already_exists(Approval),
)
def add_approval(
    parts: RequestParts,
    context: RequestContext,
    plant: PlantName,
    digest: Digest,
    approval: Annotated[ApprovalRequest | None, Body(title="Given")] = None,
    key: IdempotencyKey = None,
) -> Response:
    """One approval for each token. Where the plant's policy needs two people for a promotion, one
    approves and the other promotes. Tokens of one name count as one person. A candidate that was
    rejected before needs a reason."""
    because = None if approval is None else approval.because
    request: dict[str, Json] = {"decision": digest, "because": because}
    return create(
        parts,
        context,
        f"approvals/{plant}",
        key,
        request,
        lambda tx: approve(tx, plant, digest, because, context),
        Approval,
    )


@router.get("/plants/{plant}/decisions/{digest}/approvals", summary="List who approved a decision")
def list_approvals(parts: RequestParts, plant: PlantName, digest: Digest) -> Page[Approval]:
    with reading(parts.database) as tx:
        find.decision(tx, plant, digest)
        return Page(
            items=[Approval.model_validate(a) for a in tx.approvals.of_decision(plant, digest)]
        )


@router.get("/decisions/{digest}", summary="Get a decision by its digest alone")
def find_decision(parts: RequestParts, principal: CurrentPrincipal, digest: Digest) -> Decision:
    with reading(parts.database) as tx:
        decision = find.any_decision(tx, digest)
    require_visible(parts.database, principal, decision.plant, find.not_found("decision", digest))
    return Decision.model_validate(decision)
