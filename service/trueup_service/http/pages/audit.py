"""The page of the audit log: its entries, each proven against the head, and whether the log extends
a checkpoint that somebody kept."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import Query, Request, Response
from starlette.concurrency import run_in_threadpool

from trueup.errors import TrueupError
from trueup.ledger.audit import entry_bytes
from trueup.ledger.merkle import inclusion, leaf_hash, prove
from trueup.ledger.signed_note import head_of
from trueup_client.proof import includes
from trueup_service.authentication import Principal
from trueup_service.http.dependencies import RequestParts
from trueup_service.http.guard import CurrentPrincipal
from trueup_service.http.pages.page import form, page_router, show
from trueup_service.registry.transaction import reading
from trueup_service.signed_log import SignedLog, root_at
from trueup_service.wiring import Parts

router = page_router()
LINES = 100
NO_END = 2**62


@router.get("/audit")
def audit(
    request: Request,
    parts: RequestParts,
    principal: CurrentPrincipal,
    plant: Annotated[str, Query(max_length=63)] = "",
    kind: Annotated[str, Query(max_length=32)] = "",
    before: Annotated[int, Query(ge=1, le=NO_END)] = NO_END,
) -> Response:
    """The newest entries, or those before one, of all plants or of one, and of the kinds that begin
    with `kind`."""
    return show(
        request,
        "audit.html",
        **_listed(request, parts, principal, plant, kind, before),
        compared=None,
        pasted="",
    )


@router.post("/audit/compare")
async def compare(request: Request, parts: RequestParts, principal: CurrentPrincipal) -> Response:
    """Whether the log extends the head of a pasted checkpoint."""
    pasted = (await form(request)).get("checkpoint", "")
    comparison = await run_in_threadpool(_compared, parts, pasted)
    listed = await run_in_threadpool(_listed, request, parts, principal, "", "", NO_END)
    return show(request, "audit.html", **listed, compared=comparison, pasted=pasted)


def _listed(
    request: Request, parts: Parts, principal: Principal, plant: str, kind: str, before: int
) -> dict[str, Any]:
    log: SignedLog = request.app.state.log
    with reading(parts.database) as tx:
        of = principal.plant if principal.plant is not None else plant or None
        entries = tx.log.newest_entries(
            before, LINES, plant=of, project=principal.project, kind=kind
        )
        tree = tx.log.tree()
        root, held = tree.root(), []
        plans = [inclusion(entry.sequence - 1, tree.size) for entry in entries]
        hashes = tx.log.nodes({node for plan in plans for part in plan for node in part})
        for entry, plan in zip(entries, plans, strict=True):
            held.append(
                includes(
                    root,
                    tree.size,
                    entry.sequence - 1,
                    leaf_hash(entry_bytes(entry)),
                    prove(plan, hashes),
                )
            )
    return {
        "entries": list(zip(entries, held, strict=True)),
        "plant": plant,
        "kind": kind,
        "more": entries[-1].sequence if len(entries) == LINES else None,
        "size": tree.size,
        "root": root.hex(),
        "checkpoint": log.checkpoint(),
        "key": log.signer.verifier,
    }


def _compared(parts: Parts, pasted: str) -> tuple[bool, str]:
    """Whether the log extends the head of a checkpoint, and the answer in words."""
    try:
        size, root = head_of(pasted.strip().replace("\r\n", "\n") + "\n")
    except (TrueupError, ValueError, IndexError):
        return (
            False,
            (
                "This is no checkpoint: its lines are the log's name, the number of "
                "entries, the root, and a signature."
            ),
        )
    with reading(parts.database) as tx:
        now = tx.log.tree().size
        if size > now:
            return (
                False,
                (
                    f"The checkpoint is of {size} entries, and this log has {now}: it was "
                    "cut, or this is another one."
                ),
            )
        same = root_at(tx, size) == root
    if not same:
        return (
            False,
            (
                f"The first {size} entries are not those of the checkpoint: the log was "
                "changed, or this is another one."
            ),
        )
    return (
        True,
        (
            f"The log extends the checkpoint: its first {size} entries are the same, and "
            f"{now - size} came since."
        ),
    )
