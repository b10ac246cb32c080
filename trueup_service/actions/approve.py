"""Approve a decision, where a promotion takes more than one person."""

from __future__ import annotations

from trueup.canonical import Json
from trueup.ledger.operation import Operation
from trueup.ledger.pointer import NotAccepted
from trueup_service.actions import find
from trueup_service.actions.declare_policy import policy_of
from trueup_service.actions.stamp import Stamp
from trueup_service.errors import ApprovalMissing
from trueup_service.registry.records import Approval
from trueup_service.registry.store import Writer


def approve(writer: Writer, plant: str, decision: str, stamp: Stamp) -> tuple[Approval, bool]:
    """The approval, and whether it is new: once for each token. Raises NotFound, NotAccepted."""
    writer.lock_plant(plant)
    made = find.decision(writer, plant, decision)
    if not made.accepted:
        raise NotAccepted(decision=decision)
    known = next((a for a in writer.approvals(plant, decision) if a.token == stamp.token), None)
    if known is not None:
        return known, False
    record = Approval(plant, decision, stamp.token, stamp.now, stamp.actor)
    writer.add_approval(record)
    facts: dict[str, Json] = {"operation": Operation.CORRECTION, "token": stamp.token}
    writer.append_audit(at=stamp.now, kind="decision:approved", actor=stamp.actor, plant=plant, subject=decision, facts=facts)
    return record, True


def require_approvals(writer: Writer, plant: str, decision: str, stamp: Stamp) -> list[Json]:
    """Who approved a decision, besides whoever promotes it now. Raises ApprovalMissing where the policy takes more people."""
    policy = policy_of(writer, plant)
    others = {a.token: a.actor for a in writer.approvals(plant, decision) if a.token != stamp.token}
    needed = 1 if policy is None else policy.approvals
    if 1 + len(others) < needed:
        missing = needed - 1 - len(others)
        raise ApprovalMissing(f"{missing} more must approve this decision", needed=needed, approved_by=sorted(others.values()))
    return [others[token] for token in sorted(others)]
