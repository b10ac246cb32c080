"""Promotion and rollback of what a plant serves.

The way back is rehearsed before the pointer moves, outside any transaction, since that reads
models: of a promotion already when its candidate is accepted, so that nobody waits for it. Then the
pointer moves, if it still stands where the rehearsal found it, and where that was recorded, if the
record still holds.
"""

from __future__ import annotations

import asyncio
import math
import uuid
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any

from trueup.canonical import Json, digest_of_bytes
from trueup.code_identity import code_identity
from trueup.errors import PointerMoved, TrueupError
from trueup_service.actions import find
from trueup_service.actions.approve import require_approvals
from trueup_service.actions.continue_cycle import Cycle
from trueup_service.actions.gate_line import DECIDED
from trueup_service.actions.idempotency import once
from trueup_service.actions.move_pointer import (
    Older,
    chosen_position,
    older_positions,
    position_document,
    promote_decision,
    roll_back_pointer,
)
from trueup_service.actor_context import ActorContext
from trueup_service.errors import SwitchbackFailed
from trueup_service.registry.blobs import Blobs
from trueup_service.registry.records import ArtifactRecord, Move
from trueup_service.registry.transaction import ReadTransaction, Transaction, reading
from trueup_service.wiring import Parts

SMALL_BYTES = 1 << 20  # of arrays whose digest is checked inside a transaction


async def promote(
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

    def move(tx: Transaction, rehearsed: dict[str, Json] | None) -> dict[str, Any]:
        approvals: list[Json] = require_approvals(tx, plant, decision, context)
        approved: dict[str, Json] = {"approved_by": approvals}
        if rehearsed is None:
            rehearsed = _recorded_rehearsal(parts.blobs, tx, plant, decision, SMALL_BYTES)
        if rehearsed is None:
            raise _NotRehearsedError
        moved = promote_decision(
            tx, plant, decision, expected_generation, rehearsed, context, approved
        )
        return _moved(parts, tx, moved, context)

    def moving(rehearsed: dict[str, Json] | None) -> Callable[[Transaction], dict[str, Any]]:
        request: Json = {"decision": decision, "expected_generation": expected_generation}
        scope = f"promote/{plant}"
        return once(context, scope, key, request, lambda tx: move(tx, rehearsed))

    try:
        return await parts.writer.run_async(moving(None))
    except _NotRehearsedError:
        rehearsed = await asyncio.to_thread(_rehearse, parts, context, plant, decision)
        return await parts.writer.run_async(moving(rehearsed))


def roll_back(
    parts: Parts,
    context: ActorContext,
    plant: str,
    expected_generation: int,
    key: str | None,
    to_generation: int | None = None,
) -> dict[str, Any]:
    """Serve what served before, or at an older generation, and return the new position as a
    document. Raises PointerMoved, NothingToRollBackTo, NotToRollBackTo, SwitchbackFailed,
    KeyReused."""
    rehearsal, refusal = {}, None
    try:
        rehearsal = rehearse_way_back(parts, plant, expected_generation, to_generation)
    except PointerMoved as error:
        if key is None:
            raise
        refusal = error  # raised below, unless the request is repeated and its response is kept

    def act(tx: Transaction) -> dict[str, Any]:
        if refusal is not None:
            raise refusal
        move = roll_back_pointer(tx, plant, expected_generation, to_generation, rehearsal, context)
        return _moved(parts, tx, move, context)

    request: dict[str, Json] = {"expected_generation": expected_generation}
    if to_generation is not None:
        request["to_generation"] = to_generation
    return parts.writer.run(once(context, f"rollback/{plant}", key, request, act))


def rehearse_way_back(
    parts: Parts, plant: str, expected_generation: int, to_generation: int | None = None
) -> dict[str, Any]:
    """The record of the switchback test of what served before, or at an older generation, with the
    fallback beyond it.

    Raises PointerMoved, NothingToRollBackTo, NotToRollBackTo, and SwitchbackFailed, which names the
    next older artifact that passes its own test.
    """
    from trueup_service.actions.switchback import rehearse_rollback  # noqa: PLC0415  (numpy: a server that only serves needs none)

    with reading(parts.database) as tx:
        plant_digest = find.plant_digest(tx, plant)
        older = older_positions(tx, plant, expected_generation)
    chosen, beyond = chosen_position(older, to_generation)
    try:
        record = rehearse_rollback(parts.blobs, chosen.artifact, plant_digest)
    except SwitchbackFailed as error:
        raise _with_next(parts, plant_digest, error, beyond) from error
    return {**record, "from_generation": expected_generation, "fallback": _fallback(beyond)}


def _with_next(
    parts: Parts, plant_digest: str, failed: SwitchbackFailed, beyond: Sequence[Older]
) -> SwitchbackFailed:
    """The refusal, with the newest of the older artifacts that can serve."""
    from trueup_service.actions.switchback import rehearse_rollback  # noqa: PLC0415

    for older in beyond:
        with suppress(SwitchbackFailed):
            rehearse_rollback(parts.blobs, older.artifact, plant_digest)
            position = older.position
            return SwitchbackFailed(
                failed.message,
                hint=f"Version {position.version}, which served at generation "
                f"{position.generation}, can serve: send `to_generation` {position.generation} "
                f"(the command: --to-generation {position.generation}).",
                **{**failed.facts, "next": _named(older)},
            )
    hint = "Nothing older can serve either: keep what serves, and promote a sound artifact."
    return SwitchbackFailed(failed.message, hint=hint, **{**failed.facts, "next": None})


def _fallback(beyond: Sequence[Older]) -> Json:
    """What a robot and the next rollback fall back to if the artifact fails after the switch."""
    return _named(beyond[0]) if beyond else None


def _named(older: Older) -> dict[str, Json]:
    position = older.position
    return {
        "generation": position.generation,
        "version": position.version,
        "artifact": position.artifact,
    }


class _NotRehearsedError(Exception):
    """The way back must be rehearsed first, outside a transaction."""


def _recorded_rehearsal(
    blobs: Blobs, tx: ReadTransaction, plant: str, decision: str, limit_bytes: float
) -> dict[str, Json] | None:
    """The record of the way back that was made when the candidate of a decision was accepted, empty
    where it was not. Raises NotFound.

    None unless this code made it, and the bytes of what to go back to, up to a limit, are still
    those that it names.
    """
    made = find.decision(tx, plant, decision)
    if not made.accepted:
        return {}
    entry = tx.log.first_entry(decision, DECIDED)
    rehearsed: Any = {} if entry is None else entry.facts.get("rehearsed") or {}
    if rehearsed.get("loaded_by") != code_identity():
        return None
    incumbent = find.artifact(tx, plant, made.incumbent)
    return dict(rehearsed) if is_intact(blobs, incumbent, limit_bytes) else None


def _rehearse(parts: Parts, context: ActorContext, plant: str, decision: str) -> dict[str, Json]:
    """The record of the way back from the candidate of a decision, rehearsed now where the recorded
    one does not hold, empty where the pointer has moved on. Raises NotFound, SwitchbackFailed."""
    with reading(parts.database) as tx:
        if find.decision(tx, plant, decision).generation != find.serving(tx, plant).generation:
            return {}
        recorded = _recorded_rehearsal(parts.blobs, tx, plant, decision, math.inf)
        if recorded is not None:
            return recorded
        made = find.decision(tx, plant, decision)
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


def is_intact(blobs: Blobs, record: ArtifactRecord, limit_bytes: float) -> bool:
    """Whether an artifact's manifest and arrays are still the bytes that its digests name. False
    also where its arrays have more than so many bytes."""
    if digest_of_bytes(record.manifest.encode()) != record.digest:
        return False
    if record.arrays is None:
        return True
    try:
        return (
            blobs.size(record.arrays) <= limit_bytes
            and digest_of_bytes(blobs.get(record.arrays)) == record.arrays
        )
    except TrueupError:
        return False


def _moved(parts: Parts, tx: Transaction, move: Move, context: ActorContext) -> dict[str, Any]:
    """Continue the cycle after a move, and return the position as a document."""
    Cycle(tx, parts.queue, lambda: uuid.uuid4().hex, context).moved(move)
    return position_document(move)
