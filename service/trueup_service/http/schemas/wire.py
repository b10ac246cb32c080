"""What every response is made of: pages, problems, envelopes, and the usual types of fields."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any, Generic, TypeVar

from pydantic import BaseModel, ConfigDict, Field

T = TypeVar("T")


A = TypeVar("A", bound="FromRecord")


Digest = Annotated[
    str, Field(pattern=r"^[0-9a-f]{64}$", description="SHA-256, lower-case hexadecimal")
]


Time = Annotated[
    str,
    Field(description="UTC, ISO 8601 with microseconds", examples=["2026-01-31T12:00:00.000000Z"]),
]


NAME_PATTERN = r"^[a-z0-9][a-z0-9_-]{0,62}$"
Name = Annotated[str, Field(pattern=NAME_PATTERN)]


class FromRecord(BaseModel):
    """A response that is made from a record of the registry."""

    model_config = ConfigDict(from_attributes=True)


class RequestBody(BaseModel):
    """The body of a request. It has no fields but those that are declared."""

    model_config = ConfigDict(extra="forbid")


class Problem(BaseModel):
    """A refusal (RFC 9457). `code` is stable, `hint` says what to do next, and `facts` has values
    for programs."""

    type: str
    title: str
    status: int
    detail: str
    code: str
    hint: str
    facts: dict[str, Any]
    request_id: str | None


class Page(BaseModel, Generic[T]):
    """One page of a collection. `next` is the cursor of the next page, null at the end."""

    items: list[T]
    next: str | None = None


def page(kind: type[A], records: Sequence[object], limit: int, cursor: str) -> Page[A]:
    """Records as a page. Where there may be more, `next` is the field `cursor` of the last one."""
    more = str(getattr(records[-1], cursor)) if len(records) == limit else None
    return Page[A](items=[kind.model_validate(record) for record in records], next=more)


class Envelope(BaseModel):
    """A signed document (DSSE 1.0): `payload` is its canonical JSON in base64."""

    payload: str
    payloadType: str  # noqa: N815  (the standard's name)
    signatures: list[dict[str, str]]


class Health(BaseModel):
    """That the process responds, and its version."""

    status: str
    version: str


class Readiness(BaseModel):
    """Whether the service can do its work. Each check is `ok`, or says what is wrong."""

    ready: bool
    checks: dict[str, str]
