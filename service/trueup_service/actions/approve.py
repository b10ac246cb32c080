"""Approve a decision, where a promotion takes more than one person."""

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
from trueup_service.actions.stamp import Stamp
from trueup_service.errors import ApprovalMissing, BadRequest, RejectedBefore
from trueup_service.registry.records import Approval, DecisionRecord
from trueup_service.registry.store import Reader, Writer


def approve(
    writer: Writer, plant: str, decision: str, because: str | None, stamp: Stamp
) -> tuple[Approval, bool]:
    """The approval, and whether it is new: once for each token.

    Raises NotFound, NotAccepted, BadRequest for a reason of which nothing is seen.
    """
    if because is not None and not seen(because):
        raise BadRequest(
            "because holds nothing that can be seen",
            hint="Say in a sentence why this may go on.",
            field="because",
        )
    writer.lock_plant(plant)
    made = find.decision(writer, plant, decision)
    if not made.accepted:
        raise NotAccepted(decision=decision)
    known = next((a for a in writer.approvals(plant, decision) if a.token == stamp.token), None)
    if known is not None:
        return known, False
    record = Approval(plant, decision, stamp.token, stamp.now, stamp.actor, because)
    writer.add_approval(record)
    facts: dict[str, Json] = {
        "operation": Operation.CORRECTION,
        "token": stamp.token,
        **({} if because is None else {"because": because}),
    }
    writer.append_audit(
        at=stamp.now,
        kind="decision:approved",
        actor=stamp.actor,
        plant=plant,
        subject=decision,
        facts=facts,
    )
    return record, True


def approved_by_others(reader: Reader, plant: str, decision: str, stamp: Stamp) -> list[Approval]:
    """One approval of each person besides whoever promotes it now, the one with a reason before
    others; of revoked tokens none."""
    promoting = person_of(reader, stamp.token, stamp.actor)
    people: dict[str, Approval] = {}
    for approval in sorted(
        reader.approvals(plant, decision), key=lambda a: (a.because is None, a.at, a.token)
    ):
        person = person_of(reader, approval.token, approval.actor)
        if person is not None and person != promoting:
            people.setdefault(person, approval)
    return [people[person] for person in sorted(people)]


def require_approvals(reader: Reader, plant: str, decision: str, stamp: Stamp) -> list[Json]:
    """Who approved a decision, besides whoever promotes it now. Raises ApprovalMissing where the
    policy takes more people."""
    policy = policy_of(reader, plant)
    others = [a.actor for a in approved_by_others(reader, plant, decision, stamp)]
    needed = 1 if policy is None else policy.approvals
    if 1 + len(others) < needed:
        missing = needed - 1 - len(others)
        people = "person" if missing == 1 else "people"
        raise ApprovalMissing(
            f"{missing} more {people} must approve this decision", needed=needed, approved_by=others
        )
    return list(others)


def require_not_rejected(
    reader: Reader, plant: str, made: DecisionRecord, stamp: Stamp
) -> dict[str, Json]:
    """What a promotion tells of a candidate that was rejected before: nothing, where none was.

    It takes episodes that came in after the gate and after the rejection, or somebody else's
    approval with a reason, unless the policy forbids it. Raises RejectedBefore.
    """
    rejected = rejections(reader, made)
    if not rejected:
        return {}
    digests: list[Json] = [other.digest for other in rejected]
    old = stale(reader, made, rejected)
    if not old:
        return {"rejected_before": digests, "fresh_episodes": True}
    policy = policy_of(reader, plant)
    reasons: list[Json] = [
        {"actor": a.actor, "because": a.because}
        for a in approved_by_others(reader, plant, made.digest, stamp)
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
