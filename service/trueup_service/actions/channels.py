"""Channels of serving: further pointers of a plant, which serve what its own pointer has served,
and only with the evidence that they require.

The pointer of a plant moves by decisions. A channel, such as `staging` or `field`, follows it to an
artifact that has served there and has passed evidence at each stage that the channel requires.
Going back is a move like any other.
"""

from __future__ import annotations

from collections.abc import Sequence

from trueup.canonical import Json
from trueup.episode.role import STAGES
from trueup.errors import PointerMoved
from trueup.ledger.operation import Operation
from trueup_service.actions import find
from trueup_service.actor_context import ActorContext
from trueup_service.errors import BadRequest, Conflict, EvidenceMissing, NeverServed
from trueup_service.registry.records import ChannelMove, ChannelRecord
from trueup_service.registry.transaction import Transaction


def declare_channel(
    tx: Transaction, plant: str, name: str, requires: Sequence[str], context: ActorContext
) -> tuple[ChannelRecord, bool]:
    """Declare a channel. Returns it, and whether it is new. Raises NotFound, BadRequest for an
    unknown stage, and Conflict where the channel requires other stages."""
    find.plant_digest(tx, plant)
    if set(requires) - set(STAGES):
        raise BadRequest(f"a channel requires stages of {', '.join(STAGES)}", field="requires")
    ordered = [s for s in STAGES if s in requires]
    tx.plants.lock(plant)
    known = tx.channels.get(plant, name)
    if known is not None:
        if known.requires != ordered:
            raise Conflict(
                f"channel {name!r} requires something else already", requires=known.requires
            )
        return known, False
    record = ChannelRecord(
        plant=plant, name=name, requires=ordered, created_at=context.now, created_by=context.actor
    )
    tx.channels.add(record)
    facts: dict[str, Json] = {"requires": list(ordered)}
    tx.log.append(context, "channel:declared", plant=plant, subject=name, facts=facts)
    return record, True


def move_channel(
    tx: Transaction,
    plant: str,
    name: str,
    artifact: str,
    expected_generation: int,
    context: ActorContext,
) -> ChannelMove:
    """Move a channel to an artifact. Raises NotFound, PointerMoved, NeverServed,
    EvidenceMissing."""
    channel, wanted = find.channel(tx, plant, name), find.artifact(tx, plant, artifact)
    tx.plants.lock(plant)
    before = tx.channel_moves.last(plant, name)
    generation = before.generation if before else 0
    if generation != expected_generation:
        raise PointerMoved(
            f"generation {expected_generation} was expected, channel {name!r} is at {generation}",
            expected=expected_generation,
            found=generation,
        )
    if not tx.serving.has_served(plant, artifact):
        raise NeverServed(
            f"version {wanted.version} has never served the plant itself", artifact=artifact
        )
    # A stage that failed after it had passed counts as failed.
    last = tx.evidence.last_by_stage(plant, artifact)
    missing = [stage for stage in channel.requires if not last.get(stage, ("", False))[1]]
    if missing:
        raise EvidenceMissing(
            f"version {wanted.version} has no passed evidence of {', '.join(missing)}",
            stages=missing,
            artifact=artifact,
        )
    evidence = [last[stage][0] for stage in channel.requires]
    at = max(before.at, context.now) if before else context.now
    move = ChannelMove(
        plant=plant,
        channel=name,
        generation=generation + 1,
        artifact=artifact,
        version=wanted.version,
        evidence=evidence,
        at=at,
        actor=context.actor,
    )
    tx.channel_moves.add(move)
    facts: dict[str, Json] = {
        "operation": Operation.CORRECTION,
        "channel": name,
        "generation": move.generation,
        "evidence": list(evidence),
    }
    tx.log.append(context, "channel:moved", plant=plant, subject=artifact, facts=facts)
    return move
