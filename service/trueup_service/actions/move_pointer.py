"""Move a serving pointer: forward by a decision, back after a switchback test."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

from trueup.canonical import Json, digest_of
from trueup.errors import BrokenChain
from trueup.ledger.operation import Operation
from trueup.ledger.pointer import (
    JudgedDecision,
    NothingToRollBackTo,
    NotToRollBackTo,
    ServingPointer,
    promote,
    require_generation,
    roll_back,
)
from trueup_service.actions import find
from trueup_service.actions.approve import require_not_rejected
from trueup_service.actor_context import ActorContext
from trueup_service.registry.records import ArtifactRecord, DecisionRecord, Move, MoveKind
from trueup_service.registry.transaction import ReadTransaction, Transaction


def promote_decision(
    tx: Transaction,
    plant: str,
    decision: str,
    expected_generation: int,
    rehearsed: dict[str, Json],
    context: ActorContext,
    approved: Mapping[str, Json] = MappingProxyType({}),
) -> Move:
    """Move the pointer to a decision's candidate, and return the new position. `rehearsed` is the
    record of the rehearsed way back, and `approved` says who approved.

    Raises PointerMoved, NotAccepted, RejectedBefore, NotFound.
    """
    tx.plants.lock(plant)
    now = find.serving(tx, plant)
    made = find.decision(tx, plant, decision)
    judged = _judged(made)
    pointer = promote(_pointer(now), judged, expected_generation, _later(now, context))
    rejected = require_not_rejected(tx, plant, made, context)
    artifact = find.artifact(tx, plant, pointer.artifact)
    move = Move(
        plant=plant,
        generation=pointer.generation,
        kind=MoveKind.PROMOTED,
        artifact=artifact.digest,
        version=artifact.version,
        decision=decision,
        back_to=now.generation,
        at=pointer.since,
        actor=context.actor,
    )
    return _move(
        tx, now, move, context, {"gate": made.gate, "rehearsed": rehearsed, **approved, **rejected}
    )


def _judged(made: DecisionRecord) -> JudgedDecision:
    """What the decision's document says. Raises BrokenChain where the document is not the one that
    the digest names."""
    document: dict[str, Any] = made.document
    if digest_of(document) != made.digest:
        raise BrokenChain(
            "the decision's document is not the one that its digest names", decision=made.digest
        )
    return JudgedDecision(
        made.digest,
        document["accepted"],
        document["candidate"],
        document["incumbent"],
        document["generation"],
    )


@dataclass(frozen=True, slots=True)
class Older:
    """A position that a rollback may return to, and its artifact."""

    position: Move
    artifact: ArtifactRecord


def older_positions(tx: ReadTransaction, plant: str, expected_generation: int) -> list[Older]:
    """The positions that a rollback may return to, what served before first, then what served
    before that, to the registered model. Raises PointerMoved, NothingToRollBackTo."""
    now = find.serving(tx, plant)
    require_generation(_pointer(now), expected_generation)
    older: list[Older] = []
    back_to = now.back_to
    while back_to is not None and (back := tx.serving.at_generation(plant, back_to)) is not None:
        older.append(Older(back, find.artifact(tx, plant, back.artifact)))
        back_to = back.back_to
    if not older:
        raise NothingToRollBackTo(plant=plant)
    return older


def chosen_position(
    older: Sequence[Older], to_generation: int | None
) -> tuple[Older, Sequence[Older]]:
    """The position to return to, what served before where none is named, and those older than it.
    Raises NotToRollBackTo."""
    if to_generation is None:
        return older[0], older[1:]
    generations = [o.position.generation for o in older]
    if to_generation not in generations:
        raise NotToRollBackTo(
            f"a rollback to generation {to_generation} is not possible",
            hint=f"Choose one of {', '.join(map(str, generations))}.",
            generations=generations,
        )
    at = generations.index(to_generation)
    return older[at], older[at + 1 :]


def roll_back_pointer(
    tx: Transaction,
    plant: str,
    expected_generation: int,
    to_generation: int | None,
    tested: dict[str, Json],
    context: ActorContext,
) -> Move:
    """Move the pointer back to the artifact that served before, or at an older generation, and
    return the new position. `tested` is the record of the switchback test.

    Raises PointerMoved, NothingToRollBackTo, NotToRollBackTo.
    """
    tx.plants.lock(plant)
    now = find.serving(tx, plant)
    chosen, _ = chosen_position(older_positions(tx, plant, expected_generation), to_generation)
    back, artifact = chosen.position, chosen.artifact
    pointer = roll_back(_pointer(now), artifact.digest, expected_generation, _later(now, context))
    move = Move(
        plant=plant,
        generation=pointer.generation,
        kind=MoveKind.ROLLED_BACK,
        artifact=artifact.digest,
        version=artifact.version,
        decision=back.decision,
        back_to=back.back_to,
        at=pointer.since,
        actor=context.actor,
    )
    return _move(tx, now, move, context, {"switchback": tested})


def _move(
    tx: Transaction, before: Move, move: Move, context: ActorContext, facts: dict[str, Json]
) -> Move:
    tx.serving.move(move)
    moved: dict[str, Json] = {
        "operation": Operation.CORRECTION,
        "move": move.kind,
        "generation": move.generation,
        "from": before.artifact,
        "decision": move.decision,
        "token": context.token,
        **facts,
    }
    tx.log.append(context, "pointer:moved", plant=move.plant, subject=move.artifact, facts=moved)
    return move


def position_document(move: Move) -> dict[str, Any]:
    """A position of the pointer as responses and idempotency keys have it."""
    return {
        "plant": move.plant,
        "version": move.version,
        "artifact": move.artifact,
        "generation": move.generation,
        "since": move.at,
        "decision": move.decision,
        "move": str(move.kind),
        "actor": move.actor,
    }


def _pointer(move: Move) -> ServingPointer:
    return ServingPointer(move.plant, move.generation, move.artifact, move.decision, move.at)


def _later(before: Move, context: ActorContext) -> str:
    """The time of a move, which is never before that of the move it follows, whatever the clock
    does."""
    return max(before.at, context.now)
