"""Approve a decision, where a promotion needs more than one person."""

from __future__ import annotations

from typing import Any

from trueup.canonical import Json
from trueup.gate.policy import FORBID
from trueup.ledger.operation import Operation
from trueup.ledger.pointer import NotAccepted
from trueup.text import seen
from trueup_service.actions import find
from trueup_service.actions.declare_policy import policy_of
from trueup_service.actions.gate_line import rejections, stale
from trueup_service.actions.people import person_of
from trueup_service.actor_context import ActorContext
from trueup_service.errors import ApprovalMissing, BadRequest, RejectedBefore
from trueup_service.registry.records import Approval, DecisionRecord
from trueup_service.registry.transaction import ReadTransaction, Transaction


def approve(
    tx: Transaction, plant: str, decision: str, because: str | None, context: ActorContext
) -> tuple[Approval, bool]:
    """Approve a decision, once for each token. Returns the approval, and whether it is new.

    Raises NotFound, NotAccepted, and BadRequest where the reason has no visible character.
    """
    if because is not None and not seen(because):
        raise BadRequest(
            "because holds nothing that can be seen",
            hint="Say in a sentence why this may go on.",
            field="because",
        )
    tx.plants.lock(plant)
    made = find.decision(tx, plant, decision)
    if not made.accepted:
        raise NotAccepted(decision=decision)
    known = next(
        (a for a in tx.approvals.of_decision(plant, decision) if a.token == context.token), None
    )
    if known is not None:
        return known, False
    record = Approval(
        plant=plant,
        decision=decision,
        token=context.token,
        at=context.now,
        actor=context.actor,
        because=because,
    )
    tx.approvals.add(record)
    facts: dict[str, Json] = {
        "operation": Operation.CORRECTION,
        "token": context.token,
        **({} if because is None else {"because": because}),
    }
    tx.log.append(context, "decision:approved", plant=plant, subject=decision, facts=facts)
    return record, True


def approved_by_others(
    tx: ReadTransaction, plant: str, decision: str, context: ActorContext
) -> list[Approval]:
    """One approval of each person other than the one who promotes, by name. Of several approvals of
    a person the first with a reason counts, and those of revoked tokens do not."""
    approvals = tx.approvals.of_decision(plant, decision)
    promoting = person_of(tx, context.token, context.actor) if approvals else None
    people: dict[str, Approval] = {}
    for approval in sorted(approvals, key=lambda a: (a.because is None, a.at, a.token)):
        person = person_of(tx, approval.token, approval.actor)
        if person is not None and person != promoting:
            people.setdefault(person, approval)
    return [people[person] for person in sorted(people)]


def require_approvals(
    tx: ReadTransaction, plant: str, decision: str, context: ActorContext
) -> list[Json]:
    """The actors who approved a decision, other than the one who promotes. Raises ApprovalMissing
    where the policy needs more people."""
    policy = policy_of(tx, plant)
    others = [a.actor for a in approved_by_others(tx, plant, decision, context)]
    needed = 1 if policy is None else policy.approvals
    if 1 + len(others) < needed:
        missing = needed - 1 - len(others)
        people = "person" if missing == 1 else "people"
        raise ApprovalMissing(
            f"{missing} more {people} must approve this decision", needed=needed, approved_by=others
        )
    return list(others)


def require_not_rejected(
    tx: ReadTransaction, plant: str, made: DecisionRecord, context: ActorContext
) -> dict[str, Json]:
    """The facts that the log tells of a promotion whose candidate was rejected before. They are
    empty where it was not.

    Such a promotion needs held-out episodes that came in after the gate and after the rejection, or
    an approval with a reason by another person, unless the policy forbids that. Raises
    RejectedBefore.
    """
    rejected = rejections(tx, made)
    if not rejected:
        return {}
    digests: list[Json] = [other.digest for other in rejected]
    old = stale(tx, made, rejected)
    if not old:
        return {"rejected_before": digests, "fresh_episodes": True}
    policy = policy_of(tx, plant)
    reasons: list[Json] = [
        {"actor": a.actor, "because": a.because}
        for a in approved_by_others(tx, plant, made.digest, context)
        if a.because is not None
    ]
    forbidden = policy is not None and policy.on_rejected == FORBID
    if reasons and not forbidden:
        return {"rejected_before": digests, "approved_because": reasons}
    message = (
        f"decision {rejected[0].digest[:12]} rejected candidate {made.candidate[:12]}; "
        f"{len(old)} of the episodes on which it was accepted "
        "came in before that rejection, or before the gate"
    )
    facts: dict[str, Any] = {"rejected_by": digests[:10], "stale": old[:10]}
    if forbidden:
        facts["hint"] = (
            "The plant's policy forbids it: record fresh held-out episodes and judge on "
            "those alone."
        )
    raise RejectedBefore(message, **facts)
