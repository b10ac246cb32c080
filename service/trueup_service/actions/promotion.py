"""Promotion and rollback of what a plant serves.

The way back is rehearsed first, outside any transaction, since that reads models. Then the pointer
moves, if it still stands where the rehearsal found it.
"""

from __future__ import annotations

import uuid
from typing import Any

from trueup.canonical import Json
from trueup.errors import PointerMoved
from trueup_service.actions import find
from trueup_service.actions.approve import require_approvals
from trueup_service.actions.continue_cycle import Cycle
from trueup_service.actions.idempotency import run_once
from trueup_service.actions.move_pointer import (
    position_document,
    previous_artifact,
    promote_decision,
    roll_back_pointer,
)
from trueup_service.actor_context import ActorContext
from trueup_service.registry.records import Move
from trueup_service.registry.transaction import Transaction, reading
from trueup_service.wiring import Parts


def promote(
    parts: Parts,
    context: ActorContext,
    plant: str,
    decision: str,
    expected_generation: int,
    key: str | None,
) -> dict[str, Any]:
    """Serve the candidate of an accepted decision, and return the new position as a document.

    Raises NotFound, NotAccepted, RejectedBefore, ApprovalMissing, PointerMoved, SwitchbackFailed,
    KeyReused.
    """
    rehearsal = _rehearse_promotion(parts, context, plant, decision)

    def act(tx: Transaction) -> dict[str, Any]:
        approved: dict[str, Json] = {"approved_by": require_approvals(tx, plant, decision, context)}
        move = promote_decision(
            tx, plant, decision, expected_generation, rehearsal, context, approved
        )
        return _moved(parts, tx, move, context)

    request: Json = {"decision": decision, "expected_generation": expected_generation}
    return run_once(parts, context, f"promote/{plant}", key, request, act)


def roll_back(
    parts: Parts, context: ActorContext, plant: str, expected_generation: int, key: str | None
) -> dict[str, Any]:
    """Serve what served before, and return the new position as a document. Raises PointerMoved,
    NothingToRollBackTo, SwitchbackFailed, KeyReused."""
    rehearsal, refusal = {}, None
    try:
        rehearsal = rehearse_way_back(parts, plant, expected_generation)
    except PointerMoved as error:
        if key is None:
            raise
        refusal = error  # raised below, unless the request is repeated and its response is kept

    def act(tx: Transaction) -> dict[str, Any]:
        if refusal is not None:
            raise refusal
        move = roll_back_pointer(tx, plant, expected_generation, rehearsal, context)
        return _moved(parts, tx, move, context)

    request: Json = {"expected_generation": expected_generation}
    return run_once(parts, context, f"rollback/{plant}", key, request, act)


def rehearse_way_back(parts: Parts, plant: str, expected_generation: int) -> dict[str, Any]:
    """The record of the switchback test of what served before. Raises PointerMoved,
    NothingToRollBackTo, SwitchbackFailed."""
    from trueup_service.actions.switchback import rehearse_rollback  # noqa: PLC0415  (numpy: a server that only serves needs none)

    with reading(parts.database) as tx:
        plant_digest = find.plant_digest(tx, plant)
        _, artifact = previous_artifact(tx, plant, expected_generation)
    return rehearse_rollback(parts.blobs, artifact, plant_digest)


def _rehearse_promotion(
    parts: Parts, context: ActorContext, plant: str, decision: str
) -> dict[str, Any]:
    """The record of the way back from the candidate of a decision, empty where the decision cannot
    be promoted anyway. Raises NotFound, SwitchbackFailed."""
    with reading(parts.database) as tx:
        made, serving = find.decision(tx, plant, decision), find.serving(tx, plant)
        if not made.accepted or made.generation != serving.generation:
            return {}
        incumbent = find.artifact(tx, plant, made.incumbent)
        candidate = find.artifact(tx, plant, made.candidate)
        plant_digest = find.plant_digest(tx, plant)
        gate = find.gate(tx, plant, made.gate)
    from trueup_service.actions.switchback import rehearse_decision  # noqa: PLC0415  (numpy: a server that only serves needs none)

    return rehearse_decision(
        parts.blobs,
        parts.spool,
        incumbent,
        candidate,
        plant_digest,
        made.document,
        gate.document,
        context.now,
    )


def _moved(parts: Parts, tx: Transaction, move: Move, context: ActorContext) -> dict[str, Any]:
    """Continue the cycle after a move, and return the position as a document."""
    Cycle(tx, parts.queue, lambda: uuid.uuid4().hex, context).moved(move)
    return position_document(move)
