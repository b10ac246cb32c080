"""The audit log on the wire."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel, Field

from trueup_service.http.schemas.wire import Digest, FromRecord, Time


class AuditEntry(FromRecord):
    """An entry of the audit log: who did what to which subject, when."""

    sequence: int
    at: Time
    kind: str
    actor: str
    plant: str | None
    subject: str
    facts: dict[str, Any]
    rows: dict[str, Digest] = Field(
        description="Every row that was written: table/key, and its digest as it was then"
    )


class AuditKey(BaseModel):
    """A public key that signed the log. `endorsement` is the note in which the key before endorses
    it, null for the first."""

    verifier: str
    endorsement: str | None


class AuditKeys(BaseModel):
    """The keys of the log in order. The last one signs."""

    items: list[AuditKey]


class Proof(BaseModel):
    """A proof of RFC 9162, in a log of `size` entries."""

    size: int
    hashes: list[str] = Field(description="base64, from the leaf up")


class Rows(BaseModel):
    """Rows of a table with all columns as they are stored. `next` goes into `after` of the next
    request, null at the end."""

    items: list[dict[str, Any]]
    next: str | None = None
