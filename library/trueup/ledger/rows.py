"""Rows of the registry as the log names them: `table/key`, and the digest over every column.

Documents count as the text that is stored, 64-bit integers as text. A name and a digest mean the
same for ever, or old logs could not be checked. What is under way (a job before its end) and what
only saves time is not named.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import orjson

from trueup.canonical import Json, digest_of, digest_of_bytes

KEYS: Mapping[str, tuple[str, ...]] = {
    "projects": ("name",),
    "tokens": ("prefix",),
    "plants": ("name",),
    "episodes": ("plant", "digest"),
    "artifacts": ("plant", "version"),
    "gates": ("plant", "digest"),
    "jobs": ("id",),
    "outputs": ("job", "name"),
    "decisions": ("digest",),
    "serving": ("plant",),
    "moves": ("plant", "generation"),
    "approvals": ("plant", "decision", "token"),
    "imports": ("plant",),
    "monitors": ("plant", "digest"),
    "watching": ("plant",),
    "watches": ("plant", "monitor", "sequence"),
    "alarms": ("id",),
    "policies": ("plant", "sequence"),
    "evidence": ("plant", "digest"),
    "channels": ("plant", "name"),
    "channel_moves": ("plant", "channel", "generation"),
    "webhooks": ("name",),
    "labels": ("plant", "kind", "subject"),
}
FINAL = ("succeeded", "failed", "cancelled")
# tables whose rows are named by the digest of their document
BY_DOCUMENT = ("plants", "gates", "decisions", "monitors", "policies", "evidence")
# tables of a registry as a whole, never of one plant
NOT_OF_A_PLANT = ("projects", "tokens", "webhooks")
# kinds of entries that name rows which were written elsewhere
WHOLESALE = ("log:migrated", "plant:imported")
# kinds of entries that may name a row of a table of moves
MOVES = {"moves": ("pointer:moved", "plant:registered"), "channel_moves": ("channel:moved",)}


def row_name(table: str, row: Mapping[str, Any]) -> str:
    """The name of a row in the log."""
    return "/".join((table, *(str(row[column]) for column in KEYS[table])))


def row_digest(table: str, row: Mapping[str, Json]) -> str:
    """The digest of a row, its columns by name; empty ones are left out, so that a column that
    comes later changes no old digest."""
    return digest_of(
        {"table": table, "row": {name: value for name, value in row.items() if value is not None}}
    )


def must_be_named(table: str, row: Mapping[str, Any]) -> bool:
    """Whether the log must name a row as it is now."""
    return table != "jobs" or row["state"] in FINAL


def misnamed(table: str, row: Mapping[str, Any]) -> str | None:
    """How the content of a row differs from what names it, in words; None where it does not."""
    if table == "artifacts" and digest_of_bytes(row["manifest"].encode()) != row["digest"]:
        return "the manifest is not what its digest names"
    if table in BY_DOCUMENT and digest_of_bytes(row["document"].encode()) != row["digest"]:
        return "the document is not what its digest names"
    if table == "decisions":
        document = orjson.loads(row["document"])
        if any(
            document[name] != row[name]
            for name in ("gate", "candidate", "incumbent", "generation", "accepted")
        ):
            return "the columns are not what the document says"
    return None


def blobs(table: str, row: Mapping[str, Any]) -> list[str]:
    """Digests of the blobs that a row names."""
    named = {
        "episodes": "digest",
        "artifacts": "arrays",
        "imports": "entries",
        "outputs": "digest",
    }.get(table)
    return [row[named]] if named and row[named] else []
