"""The page of a decision: every figure against its threshold, the episodes, the place in the log,
and the newest recomputation."""

from __future__ import annotations

from typing import Any

from fastapi import Request, Response

from trueup.canonical import digest_of
from trueup.gate.line import alike, budget_of, disclosure_of, selected
from trueup.ledger.audit import entry_bytes
from trueup.ledger.merkle import inclusion, leaf_hash, prove
from trueup_service.actions import find
from trueup_service.actions.gate_line import known_at, place
from trueup_service.http.dependencies import Digest, PlantName, RequestContext, RequestParts
from trueup_service.http.guard import guarded
from trueup_service.http.pages.page import begin_job, go, show
from trueup_service.registry.records import FINAL, DecisionRecord, GateRecord
from trueup_service.registry.transaction import ReadTransaction, reading

router = guarded("", ["pages"], documented=False)


@router.get("/plants/{plant}/decisions/{digest}")
def decision(request: Request, parts: RequestParts, plant: PlantName, digest: Digest) -> Response:
    """A decision, with its proof in the log and its newest recomputation."""
    with reading(parts.database) as tx:
        made = find.decision(tx, plant, digest)
        gate = find.gate(tx, plant, made.gate)
        both = {
            which: find.artifact(tx, plant, getattr(made, which))
            for which in ("candidate", "incumbent")
        }
        entry, proof = tx.log.first_entry(digest, "decision:made"), []
        tree = tx.log.tree()
        if entry is not None:
            plan = inclusion(entry.sequence - 1, tree.size)
            proof = [h.hex() for h in prove(plan, tx.log.nodes([n for part in plan for n in part]))]
        anew = tx.jobs.last_matching(plant, "recompute", lambda r: r["decision"] == digest)
        values: dict[str, Any] = {
            "plant": plant,
            "made": made,
            "whole": digest_of(made.document) == digest,
            "gate": gate,
            "artifacts": both,
            "approvals": tx.approvals.of_decision(plant, digest),
            **_known(tx, gate, made),
            "entry": entry,
            "leaf": None if entry is None else leaf_hash(entry_bytes(entry)).hex(),
            "proof": proof,
            "size": tree.size,
            "root": tree.root().hex(),
            "anew": anew,
            "waiting": anew is not None and anew.state not in FINAL,
        }
    return show(request, "decision.html", **values)


def _known(tx: ReadTransaction, gate: GateRecord, made: DecisionRecord) -> dict[str, Any]:
    """What was known when the gate was declared, from the decision or worked out now, and what is
    looser in the gate."""
    document: dict[str, Any] = made.document
    known = document.get("known") or known_at(
        tx, made.plant, gate, made.candidate, document["episodes"]
    )
    return {
        "known": known,
        "disclosure": " ".join([disclosure_of(made.candidate, known), *selected(document)]),
        "warns": bool(known["candidate"] or known["compared"] or alike(document)),
        "place": place(tx, made.plant, gate.digest),
        "budget": budget_of(gate.document),
    }


@router.post("/plants/{plant}/decisions/{digest}/recompute")
def recompute(
    parts: RequestParts, context: RequestContext, plant: PlantName, digest: Digest
) -> Response:
    """Submit the recomputation of a decision from its bytes."""
    begin_job(parts, context, plant, "recompute", {"decision": digest})
    return go(f"/plants/{plant}/decisions/{digest}")
