"""Moving the pointer: the way back is tried first, outside any transaction, then the pointer moves
if it is still where it was tried."""

from __future__ import annotations

import uuid
from typing import Any

from trueup.canonical import Json
from trueup.errors import PointerMoved
from trueup_service.actions import find
from trueup_service.actions.approve import require_approvals
from trueup_service.actions.continue_cycle import Cycle
from trueup_service.actions.move_pointer import (
    previous_artifact,
    promote_decision,
    roll_back_pointer,
)
from trueup_service.actor_context import ActorContext
from trueup_service.http.context import run_once
from trueup_service.http.serving_answers import document
from trueup_service.registry.transaction import Transaction, reading
from trueup_service.wiring import Parts


def promote_tested(
    parts: Parts,
    context: ActorContext,
    plant: str,
    decision: str,
    expected_generation: int,
    key: str | None,
) -> dict[str, Any]:
    """The new position. The way back is tried outside any transaction, for that reads models; then
    it moves, if it is still there."""
    rehearsed = _rehearsed(parts, context, plant, decision)

    def act(tx: Transaction) -> dict[str, Any]:
        approved: dict[str, Json] = {"approved_by": require_approvals(tx, plant, decision, context)}
        move = promote_decision(
            tx, plant, decision, expected_generation, rehearsed, context, approved
        )
        Cycle(tx, parts.queue, lambda: uuid.uuid4().hex, context).moved(move)
        return document(move)

    return run_once(
        parts,
        context,
        f"promote/{plant}",
        key,
        {"decision": decision, "expected_generation": expected_generation},
        act,
    )


def _rehearsed(parts: Parts, context: ActorContext, plant: str, decision: str) -> dict[str, Any]:
    """The record of the way back from a decision's candidate; none where it cannot be promoted
    anyway. Raises SwitchbackFailed."""
    with reading(parts.database) as tx:
        made, serving = find.decision(tx, plant, decision), find.serving(tx, plant)
        if not made.accepted or made.generation != serving.generation:
            return {}
        artifacts = (
            find.artifact(tx, plant, made.incumbent),
            find.artifact(tx, plant, made.candidate),
        )
        registered, gate = find.plant_digest(tx, plant), find.gate(tx, plant, made.gate)
    from trueup_service.actions.switchback import rehearse_decision  # noqa: PLC0415  (numpy: a server that only serves needs none)

    return rehearse_decision(
        parts.blobs, parts.spool, *artifacts, registered, made.document, gate.document, context.now
    )


def roll_back_tested(
    parts: Parts, context: ActorContext, plant: str, expected_generation: int, key: str | None
) -> dict[str, Any]:
    """The new position. Test outside any transaction, for it reads a model; then move, if the
    pointer is still where the test found it."""
    tested, refused = {}, None
    try:
        tested = tested_way_back(parts, plant, expected_generation)
    except PointerMoved as error:
        if key is None:
            raise
        refused = error  # unless the request is a repeated one, whose answer is known

    def act(tx: Transaction) -> dict[str, Any]:
        if refused is not None:
            raise refused
        move = roll_back_pointer(tx, plant, expected_generation, tested, context)
        Cycle(tx, parts.queue, lambda: uuid.uuid4().hex, context).moved(move)
        return document(move)

    return run_once(
        parts, context, f"rollback/{plant}", key, {"expected_generation": expected_generation}, act
    )


def tested_way_back(parts: Parts, plant: str, expected_generation: int) -> dict[str, Any]:
    """The record of the switchback test on what served before. Raises PointerMoved,
    SwitchbackFailed."""
    from trueup_service.actions.switchback import rehearse_rollback  # noqa: PLC0415  (numpy: a server that only serves needs none)

    with reading(parts.database) as tx:
        registered = find.plant_digest(tx, plant)
        _, artifact = previous_artifact(tx, plant, expected_generation)
    return rehearse_rollback(parts.blobs, artifact, registered)
