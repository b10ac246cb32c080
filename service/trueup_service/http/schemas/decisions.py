"""Gates, decisions, approvals and update policies on the wire."""

from __future__ import annotations

from typing import Any

from pydantic import Field, computed_field

from trueup.gate.line import disclosure
from trueup_service.control_characters import LINE
from trueup_service.http.schemas.wire import Digest, FromRecord, RequestBody, Time


class Gate(FromRecord):
    """A gate. The last one of a plant judges, and its document names the gate that it follows and
    why."""

    plant: str
    digest: Digest
    document: dict[str, Any]
    created_at: Time
    created_by: str


class LooserThan(FromRecord):
    """An earlier gate, and in words what is looser in the later one."""

    gate: Digest
    looser: list[str]


class GateInLine(Gate):
    """A gate with its place among the gates of its plant: whether it is in force, and in words what
    is looser in it than in the gate before and in each earlier one."""

    in_force: bool
    follows: Digest | None = Field(
        description="The gate that was in force before; null for the first"
    )
    looser: list[str]
    looser_than: list[LooserThan] = Field(
        description="Each gate before it in which this one is looser, the newest first"
    )


class Decision(FromRecord):
    """A decision of a gate on a candidate, with every figure in `document`."""

    digest: Digest
    plant: str
    gate: Digest
    candidate: Digest
    incumbent: Digest
    generation: int
    accepted: bool
    document: dict[str, Any]
    job: str | None
    created_at: Time
    created_by: str

    @computed_field(  # type: ignore[prop-decorator]
        description=(
            "What was known when the gate was declared, in words; null of a decision that "
            "does not tell"
        )
    )
    @property
    def disclosure(self) -> str | None:
        """What was known when the gate was declared, in words."""
        return disclosure(self.document)


class Approval(FromRecord):
    """An approval of a decision for promotion."""

    plant: str
    decision: Digest
    token: str = Field(description="The approving token's public prefix")
    at: Time
    actor: str
    because: str | None = Field(None, description="Why, where it takes a reason")


class ApprovalRequest(RequestBody):
    """An approval. It needs a reason where the candidate was rejected before."""

    because: str | None = Field(None, min_length=1, max_length=2000, pattern=LINE)


class Policy(FromRecord):
    """An update policy: what may happen without a person. It is in force from `created_at` until
    the next one."""

    plant: str
    sequence: int
    digest: Digest
    document: dict[str, Any]
    created_at: Time
    created_by: str
