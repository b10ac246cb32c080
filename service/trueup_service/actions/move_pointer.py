"""Move a serving pointer: forward by a decision, back by a tested switch."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

from trueup.canonical import Json, digest_of
from trueup.errors import BrokenChain
from trueup.ledger.operation import Operation
from trueup.ledger.pointer import (
    JudgedDecision,
    NothingToRollBackTo,
    ServingPointer,
    promote,
    require_generation,
    roll_back,
)
from trueup_service.actions import find
from trueup_service.actions.approve import require_not_rejected
from trueup_service.actions.stamp import Stamp
from trueup_service.registry.records import ArtifactRecord, DecisionRecord, Move, MoveKind
from trueup_service.registry.store import Reader, Writer


def promote_decision(
    writer: Writer,
    plant: str,
    decision: str,
    expected_generation: int,
    rehearsed: dict[str, Json],
    stamp: Stamp,
    approved: Mapping[str, Json] = MappingProxyType({}),
) -> Move:
    """The new position, at the decision's candidate; `rehearsed` is the record of the way back,
    tried before, `approved` says by whom.

    Raises PointerMoved, NotAccepted, RejectedBefore, NotFound.
    """
    writer.lock_plant(plant)
    now = find.serving(writer, plant)
    made = find.decision(writer, plant, decision)
    judged = _judged(made)
    pointer = promote(_pointer(now), judged, expected_generation, _later(now, stamp))
    rejected = require_not_rejected(writer, plant, made, stamp)
    artifact = find.artifact(writer, plant, pointer.artifact)
    move = Move(
        plant,
        pointer.generation,
        MoveKind.PROMOTED,
        artifact.digest,
        artifact.version,
        decision,
        now.generation,
        pointer.since,
        stamp.actor,
    )
    return _move(
        writer,
        now,
        move,
        stamp,
        {"gate": made.gate, "rehearsed": rehearsed, **approved, **rejected},
    )


def _judged(made: DecisionRecord) -> JudgedDecision:
    """What the decision's document says, if it still is the one that the digest names. Raises
    BrokenChain."""
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


def previous_artifact(
    reader: Reader, plant: str, expected_generation: int
) -> tuple[Move, ArtifactRecord]:
    """The position that a rollback would return to, and its artifact. Raises PointerMoved,
    NothingToRollBackTo."""
    now = find.serving(reader, plant)
    require_generation(_pointer(now), expected_generation)
    back = None if now.back_to is None else reader.move(plant, now.back_to)
    if back is None:
        raise NothingToRollBackTo(plant=plant)
    return back, find.artifact(reader, plant, back.artifact)


def roll_back_pointer(
    writer: Writer, plant: str, expected_generation: int, tested: dict[str, Json], stamp: Stamp
) -> Move:
    """The new position, at the artifact that served before; `tested` is the record of its
    switchback test."""
    writer.lock_plant(plant)
    now = find.serving(writer, plant)
    back, artifact = previous_artifact(writer, plant, expected_generation)
    pointer = roll_back(_pointer(now), artifact.digest, expected_generation, _later(now, stamp))
    move = Move(
        plant,
        pointer.generation,
        MoveKind.ROLLED_BACK,
        artifact.digest,
        artifact.version,
        back.decision,
        back.back_to,
        pointer.since,
        stamp.actor,
    )
    return _move(writer, now, move, stamp, {"switchback": tested})


def _move(writer: Writer, before: Move, move: Move, stamp: Stamp, facts: dict[str, Json]) -> Move:
    writer.move_serving(move)
    moved: dict[str, Json] = {
        "operation": Operation.CORRECTION,
        "move": move.kind,
        "generation": move.generation,
        "from": before.artifact,
        "decision": move.decision,
        "token": stamp.token,
        **facts,
    }
    writer.append_audit(
        at=stamp.now,
        kind="pointer:moved",
        actor=stamp.actor,
        plant=move.plant,
        subject=move.artifact,
        facts=moved,
    )
    return move


def _pointer(move: Move) -> ServingPointer:
    return ServingPointer(move.plant, move.generation, move.artifact, move.decision, move.at)


def _later(before: Move, stamp: Stamp) -> str:
    """The time of a move is never before the one it follows, whatever the clock does."""
    return max(before.at, stamp.now)
