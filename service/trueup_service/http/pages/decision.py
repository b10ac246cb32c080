"""The page of a decision: every figure against its threshold, the episodes, the place in the log,
and the newest recomputation."""

from __future__ import annotations

import uuid
from typing import Any

from fastapi import Request, Response
from starlette.concurrency import run_in_threadpool

from trueup.canonical import digest_of
from trueup.episode.role import HELD_OUT
from trueup.errors import TrueupError
from trueup.gate.line import alike, budget_of, disclosure_of, selected
from trueup.ledger.audit import entry_bytes
from trueup.ledger.merkle import inclusion, leaf_hash, prove
from trueup_service.actions import find, promotion
from trueup_service.actions.approve import approve
from trueup_service.actions.declare_policy import policy_of
from trueup_service.actions.gate_line import known_at, place
from trueup_service.actions.label import label_of
from trueup_service.http.dependencies import Digest, PlantName, RequestContext, RequestParts
from trueup_service.http.pages.page import (
    act,
    begin_job,
    checked,
    form,
    go,
    page_router,
    show,
    whole_number,
)
from trueup_service.http.schemas.decisions import ApprovalRequest
from trueup_service.registry.label_record import Labelled
from trueup_service.registry.records import FINAL, DecisionRecord, GateRecord
from trueup_service.registry.transaction import ReadTransaction, reading
from trueup_service.wiring import Parts

router = page_router()


@router.get("/plants/{plant}/decisions/{digest}")
def decision(request: Request, parts: RequestParts, plant: PlantName, digest: Digest) -> Response:
    """A decision, with its proof in the log and its newest recomputation."""
    return _page(request, parts, plant, digest)


def _page(
    request: Request,
    parts: Parts,
    plant: str,
    digest: str,
    refused: TrueupError | None = None,
) -> Response:
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
        episodes: Any = made.document["episodes"]
        values: dict[str, Any] = {
            "plant": plant,
            "made": made,
            "label": label_of(tx, plant, Labelled.DECISION, digest),
            "names": find.names_of_episodes(tx, plant, episodes),
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
            "serving": find.serving(tx, plant),
            **_fresh(tx, made),
            "gate_in_force": tx.gates.in_order(plant)[-1].digest,
            "needed": _approvals_needed(tx, plant),
            "key": uuid.uuid4().hex,
            "refused": refused,
            "anew": anew,
            "waiting": anew is not None and anew.state not in FINAL,
        }
    return show(request, "decision.html", **values)


def _fresh(tx: ReadTransaction, made: DecisionRecord) -> dict[str, Any]:
    """The held-out episodes that came in after a rejection, and how the command names them; none
    of an accepted decision, whose page does not ask."""
    if made.accepted:
        return {"fresh": [], "again": []}
    later = tx.episodes.of_roles(made.plant, HELD_OUT, ingested_after=made.created_at)
    fresh = [e.digest for e in later if e.digest not in made.document["episodes"]]  # type: ignore[operator]
    named = [part for digest in fresh for part in ("--episode", digest[:12])]
    return {"fresh": fresh, "again": named}


def _approvals_needed(tx: ReadTransaction, plant: str) -> int:
    """How many people a promotion takes."""
    policy = policy_of(tx, plant)
    return 1 if policy is None else policy.approvals


@router.post("/plants/{plant}/decisions/{digest}/promote")
async def promote(
    request: Request,
    parts: RequestParts,
    context: RequestContext,
    plant: PlantName,
    digest: Digest,
) -> Response:
    """Serve the decision's candidate, if the pointer is at the generation of the form."""
    fields = await form(request)
    generation, key = whole_number(fields.get("generation", "")), fields.get("key") or None

    async def move() -> None:
        await promotion.promote(parts, context, plant, digest, generation, key)
        request.app.state.answers.wake()

    return await act(
        request,
        move,
        lambda error: _page(request, parts, plant, digest, error),
        f"/plants/{plant}",
    )


@router.post("/plants/{plant}/decisions/{digest}/approve")
async def approve_(
    request: Request,
    parts: RequestParts,
    context: RequestContext,
    plant: PlantName,
    digest: Digest,
) -> Response:
    """Approve a decision, with the reason of the form if there is one."""
    text = (await form(request)).get("because", "").strip() or None

    def approved() -> object:
        because = checked(ApprovalRequest.model_validate, {"because": text}).because
        return parts.writer.run(lambda tx: approve(tx, plant, digest, because, context))

    return await act(
        request,
        lambda: run_in_threadpool(approved),
        lambda error: _page(request, parts, plant, digest, error),
        f"/plants/{plant}/decisions/{digest}",
    )


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
