"""Declare an update policy, which is in force from then on."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from trueup.gate.policy import FORBID, REQUIRE, UpdatePolicy
from trueup_service.actions import find
from trueup_service.actions.gate_line import require_in_force
from trueup_service.actor_context import ActorContext
from trueup_service.errors import Forbidden
from trueup_service.registry.records import PolicyRecord
from trueup_service.registry.transaction import ReadTransaction, Transaction


def declare_policy(
    tx: Transaction,
    plant: str,
    document: Mapping[str, Any],
    context: ActorContext,
    *,
    by_admin: bool = False,
) -> tuple[PolicyRecord, bool]:
    """Declare an update policy. Returns it, and whether it differs from the one in force.

    Raises BadPolicy, NotFound for a gate that is not declared, GateSuperseded for one that is not
    in force, and Forbidden where somebody other than an admin makes promotions easier.
    """
    policy = UpdatePolicy.from_document(document)
    gate = find.gate(tx, plant, policy.gate)
    tx.plants.lock(plant)
    held = tx.policies.in_force(plant)
    if held is not None and held.digest == policy.digest:
        return held, False
    require_in_force(tx, plant, gate)
    before = policy_of(tx, plant)
    if before is not None and policy.approvals < before.approvals and not by_admin:
        raise Forbidden(
            f"the policy that holds takes {before.approvals} people",
            hint="An admin may declare one that takes fewer.",
        )
    if before is not None and before.on_rejected == FORBID != policy.on_rejected and not by_admin:
        raise Forbidden(
            "the policy that holds forbids to promote what was rejected",
            hint="An admin may declare one that does not.",
        )
    if before is not None and before.safeguards == REQUIRE != policy.safeguards and not by_admin:
        raise Forbidden(
            "the policy that holds requires safeguards of a recording",
            hint="An admin may declare one that does not.",
        )
    record = PolicyRecord(
        plant=plant,
        sequence=held.sequence + 1 if held else 1,
        digest=policy.digest,
        document=policy.document(),
        created_at=context.now,
        created_by=context.actor,
    )
    tx.policies.add(record)
    tx.log.append(
        context,
        "policy:declared",
        plant=plant,
        subject=policy.digest,
        facts={"policy": policy.document()},
    )
    return record, True


def policy_of(tx: ReadTransaction, plant: str) -> UpdatePolicy | None:
    """The update policy of a plant that is in force."""
    held = tx.policies.in_force(plant)
    return None if held is None else UpdatePolicy.from_document(held.document)
