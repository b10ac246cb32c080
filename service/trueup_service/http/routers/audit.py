"""Audit: the append-only log of everything that was done, its tree and its signed head.

`/v1/audit` is the prefix of a tiled log: `checkpoint`, `tile/<level>/<tile>` and
`tile/entries/<tile>` are what any reader of C2SP tlog-tiles knows. Inclusion and consistency are
also proven directly, for who does not want to read tiles.
"""

from __future__ import annotations

import base64
import re
import struct
from dataclasses import asdict
from typing import Annotated, Any

import orjson
from fastapi import Path, Query, Request, Response
from starlette.concurrency import run_in_threadpool

from trueup.ledger.audit import entry_bytes
from trueup.ledger.merkle import ProofPlan, consistency, inclusion, prove
from trueup.ledger.rows import KEYS
from trueup_service.errors import BadRequest, NotFound
from trueup_service.http.dependencies import Limit, RequestParts
from trueup_service.http.guard import CurrentPrincipal, guarded
from trueup_service.http.schemas.audit import AuditEntry, AuditKey, AuditKeys, Proof, Rows
from trueup_service.http.schemas.wire import Page, page
from trueup_service.registry.tables import metadata
from trueup_service.registry.transaction import ReadTransaction, reading
from trueup_service.signed_log import SignedLog

router = guarded("/v1/audit", ["audit"])
TILE = 256
TABLES = {name: metadata.tables[name] for name in (*KEYS, "audit_tree", "audit_head", "audit_key")}
TilePath = Annotated[
    str,
    Path(
        pattern=r"^(x[0-9]{3}/){0,5}[0-9]{3}(\.p/[0-9]{1,3})?$",
        description="tile as x001/x234/067, .p/<width>",
    ),
]
Size = Annotated[
    int, Query(ge=0, le=2**62, description="entries of the log; default: all there are")
]
TEXT: dict[int | str, dict[str, Any]] = {
    200: {"content": {"text/plain": {"schema": {"type": "string"}}}}
}
OCTETS: dict[int | str, dict[str, Any]] = {
    200: {
        "content": {"application/octet-stream": {"schema": {"type": "string", "format": "binary"}}}
    }
}
IMMUTABLE = {"Cache-Control": "private, max-age=31536000, immutable"}


@router.get("", summary="List entries in order")
def list_entries(
    parts: RequestParts,
    principal: CurrentPrincipal,
    plant: str | None = None,
    after: Annotated[int, Query(ge=0, le=2**62, description="sequence")] = 0,
    limit: Limit = 100,
) -> Page[AuditEntry]:
    """Entry n is leaf n - 1 of the tree. A leaf holds the digests of `facts` and of `rows`. A token
    of a project sees the entries of its plants."""
    with reading(parts.database) as tx:
        entries = tx.log.entries(
            after, limit, plant if principal.plant is None else principal.plant, principal.project
        )
    return page(AuditEntry, entries, limit, "sequence")


@router.get("/key", summary="The public key of the log", response_class=Response, responses=TEXT)
async def key(request: Request) -> Response:
    """`<name>+<hash>+<key>`, as C2SP signed-note defines it. Pin it: a caller that fetches the key
    at each use trusts whoever responds."""
    return Response(_log(request).signer.verifier + "\n", media_type="text/plain")


@router.get("/keys", summary="The keys under which the log was signed")
def keys(parts: RequestParts) -> AuditKeys:
    """In order. Each key but the first is endorsed by the one before, so a caller that pinned an
    earlier key can verify the last one."""
    with reading(parts.database) as tx:
        return AuditKeys(items=[AuditKey(**asdict(key)) for key in tx.log.signing_keys()])


@router.get(
    "/checkpoint", summary="The signed head of the log", response_class=Response, responses=TEXT
)
async def checkpoint(request: Request) -> Response:
    """Origin, number of entries and root, signed. The file `checkpoint` in the data folder has the
    same text, for mirrors."""
    note = await run_in_threadpool(_log(request).checkpoint)
    return Response(note, media_type="text/plain", headers={"Cache-Control": "no-cache"})


@router.get("/inclusion", summary="Prove that an entry is in the log")
def prove_inclusion(
    parts: RequestParts, sequence: Annotated[int, Query(ge=1, le=2**62)], size: Size | None = None
) -> Proof:
    with reading(parts.database) as tx:
        size = _reached(tx, size)
        if sequence > size:
            raise BadRequest(f"a log of {size} entries has no entry {sequence}", size=size)
        return _proof(tx, inclusion(sequence - 1, size), size)


@router.get("/consistency", summary="Prove that the log extends an earlier one")
def prove_consistency(
    parts: RequestParts,
    old: Annotated[int, Query(ge=0, le=2**62, description="entries then")],
    size: Size | None = None,
) -> Proof:
    with reading(parts.database) as tx:
        size = _reached(tx, size)
        if old > size:
            raise BadRequest(f"a log of {size} entries does not extend one of {old}", size=size)
        return _proof(tx, consistency(old, size), size)


def _reached(tx: ReadTransaction, size: int | None) -> int:
    now = tx.log.tree().size
    if size is not None and size > now:
        raise BadRequest(f"the log has {now} entries yet", size=now)
    return now if size is None else size


def _proof(tx: ReadTransaction, plan: ProofPlan, size: int) -> Proof:
    hashes = tx.log.nodes([node for part in plan for node in part])
    return Proof(size=size, hashes=[base64.b64encode(h).decode() for h in prove(plan, hashes)])


@router.get(
    "/tile/entries/{tile:path}",
    summary="256 entries as leaves",
    response_class=Response,
    responses=OCTETS,
)
def entries(parts: RequestParts, tile: TilePath) -> Response:
    """The bytes of each leaf behind their length (16 bits, big-endian). The leaf hashes of the tree
    are over these bytes."""
    number, width = _tile(tile)
    with reading(parts.database) as tx:
        tile_entries = tx.log.entries(number * TILE, width)
    leaves = [entry_bytes(e) for e in tile_entries]
    return _tile_answer(
        tile, len(leaves), width, b"".join(struct.pack(">H", len(leaf)) + leaf for leaf in leaves)
    )


@router.get(
    "/tile/{level}/{tile:path}",
    summary="256 hashes of the tree",
    response_class=Response,
    responses=OCTETS,
)
def hashes(
    parts: RequestParts, level: Annotated[int, Path(ge=0, le=7)], tile: TilePath
) -> Response:
    """Neighbouring subtrees of 256^level leaves each, 32 bytes each."""
    number, width = _tile(tile)
    with reading(parts.database) as tx:
        nodes = tx.log.tile(8 * level, number * TILE, width)
    return _tile_answer(tile, len(nodes), width, b"".join(nodes))


def _tile(path: str) -> tuple[int, int]:
    """The number and width of a tile. Raises NotFound where no log can have it, and BadRequest for
    a width beyond a tile."""
    name, _, part = path.partition(".p/")
    number, width = int(re.sub(r"[x/]", "", name)), int(part) if part else TILE
    if not 0 < width <= TILE or (part and width == TILE):
        raise BadRequest("a tile that is not full is 1 to 255 wide")
    if number >= 2**40:
        raise NotFound("no log has this tile", noun="tile", name=path)
    return number, width


def _tile_answer(tile: str, filled: int, width: int, content: bytes) -> Response:
    if filled < width:
        raise NotFound(
            f"the log does not fill tile {tile!r} yet",
            noun="tile",
            name=tile,
            hint="/v1/audit/checkpoint says how far it goes.",
        )
    return Response(content, media_type="application/octet-stream", headers=IMMUTABLE)


@router.get("/rows/{table}", summary="The registry's rows as they are stored")
def rows(
    parts: RequestParts,
    table: str,
    after: Annotated[str, Query(max_length=400, description="`next` of the page before")] = "",
    limit: Limit = 100,
) -> Rows:
    """The rows that entries name in `rows`, to be held against their digests: SHA-256 of the
    canonical {"row": …, "table": …}. Also what the log stores beside its entries: its hashes, its
    head and its keys."""
    stored = TABLES.get(table)
    if stored is None:
        raise NotFound(
            f"the log names no rows of {table!r}",
            noun="table",
            name=table,
            hint=f"It names those of {', '.join(TABLES)}.",
        )
    columns = list(stored.primary_key.columns)
    try:
        key = orjson.loads(after) if after else []
        key = (
            [column.type.python_type(value) for column, value in zip(columns, key, strict=True)]
            if key
            else []
        )
        if any(isinstance(value, int) and not -(2**63) <= value < 2**63 for value in key):
            raise ValueError
    except (orjson.JSONDecodeError, ValueError, TypeError) as error:
        raise BadRequest("after is `next` of the page before") from error
    with reading(parts.database) as tx:
        items = tx.rows.page(stored, key, limit)
    return Rows(
        items=items,
        next=orjson.dumps([items[-1][c.name] for c in columns]).decode()
        if len(items) == limit
        else None,
    )


def _log(request: Request) -> SignedLog:
    log: SignedLog = request.app.state.log
    return log
