"""Artifacts, evidence of them, and what serves, on the wire."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import BaseModel, Field

from trueup_service.http.schemas.wire import NAME_PATTERN, Digest, FromRecord, RequestBody, Time


class Artifact(FromRecord):
    """A version of a plant's model."""

    plant: str
    version: int
    digest: Digest
    kind: str
    arrays: Digest | None
    job: str | None
    created_at: Time
    created_by: str


class Evidence(FromRecord):
    """Evidence of an artifact at a stage of the test ladder, with its scope."""

    plant: str
    digest: Digest
    artifact: Digest
    stage: str
    passed: bool
    document: dict[str, Any]
    job: str | None
    created_at: Time
    created_by: str


class Serving(BaseModel):
    """Which artifact serves a plant, since when, and by which decision, null for the registered
    model."""

    plant: str
    version: int
    artifact: Digest
    generation: int
    since: Time
    decision: Digest | None
    move: Literal["registered", "promoted", "rolled_back"]
    actor: str


class Promotion(RequestBody):
    """Serve the candidate of a decision if the pointer is still at `expected_generation`."""

    decision: Digest
    expected_generation: int = Field(ge=1, le=2**31 - 1)


class Rollback(RequestBody):
    """Serve what served before if the pointer is still at `expected_generation`."""

    expected_generation: int = Field(ge=1, le=2**31 - 1)
    to_generation: int | None = Field(
        None,
        ge=1,
        le=2**31 - 1,
        description="an older generation whose artifact to serve, instead of what served before",
    )


class ChannelDeclaration(RequestBody):
    """A new channel of serving, and the stages whose passed evidence it requires."""

    name: str = Field(pattern=NAME_PATTERN)
    requires: list[Literal["MIL", "SIL", "PIL", "HIL", "physical"]] = Field([])


class Channel(FromRecord):
    """A channel of serving, and the stages whose passed evidence it requires."""

    plant: str
    name: str
    requires: list[str]
    created_at: Time
    created_by: str


class ChannelPosition(FromRecord):
    """What a channel serves, and the evidence that allowed it."""

    plant: str
    channel: str
    generation: int
    artifact: Digest
    version: int
    evidence: list[Digest]
    at: Time
    actor: str


class ChannelMove(RequestBody):
    """Serve an artifact on a channel if the channel is still at `expected_generation`, which is 0
    before its first move."""

    artifact: Digest
    expected_generation: int = Field(ge=0, le=2**31 - 1)
