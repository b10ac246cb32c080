"""What goes over the wire."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any, Generic, Literal, TypeVar

from pydantic import BaseModel, ConfigDict, Field, computed_field

from trueup.gate.line import disclosure
from trueup.ledger.operation import Operation, of_job
from trueup_service.control_characters import LINE
from trueup_service.registry.records import Role

T = TypeVar("T")
A = TypeVar("A", bound="Answer")
Digest = Annotated[
    str, Field(pattern=r"^[0-9a-f]{64}$", description="SHA-256, lower-case hexadecimal")
]
Time = Annotated[
    str,
    Field(description="UTC, ISO 8601 with microseconds", examples=["2026-01-31T12:00:00.000000Z"]),
]


class Answer(BaseModel):
    """An answer, made from a record."""

    model_config = ConfigDict(from_attributes=True)


class Problem(BaseModel):
    """A refusal (RFC 9457). `code` is stable, `hint` says what to do next, `facts` are values that
    a program may want."""

    type: str
    title: str
    status: int
    detail: str
    code: str
    hint: str
    facts: dict[str, Any]
    request_id: str | None


class Page(BaseModel, Generic[T]):
    """Part of a collection; `next` goes into the next request's cursor, null at the end."""

    items: list[T]
    next: str | None = None


def page(kind: type[A], found: Sequence[object], limit: int, cursor: str) -> Page[A]:
    """Records as a page; `next` is the last one's `cursor` field, if there may be more."""
    more = str(getattr(found[-1], cursor)) if len(found) == limit else None
    return Page[A](items=[kind.model_validate(record) for record in found], next=more)


Name = Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9_-]{0,62}$")]


class SignIn(BaseModel):
    """A token, to be exchanged for a session."""

    model_config = ConfigDict(extra="forbid")
    token: str = Field(max_length=200)


class Identity(Answer):
    """Who asks, and what there is for them: null for all projects, or all plants."""

    name: str
    roles: list[Role]
    project: str | None
    plant: str | None


class NewProject(BaseModel):
    """A project: its plants are there for its own tokens alone."""

    model_config = ConfigDict(extra="forbid")
    name: Name


class Project(Answer):
    name: str
    created_at: Time
    created_by: str


class NewToken(BaseModel):
    """A token for somebody. Without a project it is of all; `plant` narrows it to one; without
    `days` it does not expire."""

    model_config = ConfigDict(extra="forbid")
    name: str = Field(min_length=1, max_length=100, pattern=LINE)
    roles: list[Role] = Field(min_length=1, max_length=5)
    project: Name | None = None
    plant: Name | None = None
    days: float | None = Field(365.0, gt=0, le=36_500)


class Token(Answer):
    prefix: str
    name: str
    roles: list[Role]
    project: str | None
    plant: str | None
    created_at: Time
    created_by: str
    expires_at: Time | None
    revoked_at: Time | None
    revoked_by: str | None


class IssuedToken(Token):
    token: str = Field(description="The whole token; it is shown this once")


class Plant(Answer):
    name: str
    digest: Digest
    document: dict[str, Any]
    created_at: Time
    created_by: str
    project: str | None


class Episode(Answer):
    plant: str
    digest: Digest
    size_bytes: int
    role: str
    summary: dict[str, Any]
    created_at: Time
    created_by: str


class EpisodeContext(Episode):
    """An episode joined to what was serving while it was recorded, and how often it was used."""

    served: list[Serving]
    uses: dict[str, int]


class Upload(BaseModel):
    """An upload under way: how many of its bytes are here, and durable."""

    digest: Digest
    offset_bytes: int


class Artifact(Answer):
    plant: str
    version: int
    digest: Digest
    kind: str
    arrays: Digest | None
    job: str | None
    created_at: Time
    created_by: str


class Gate(Answer):
    """A gate. A plant's last one judges; its document names the one that it follows, and why."""

    plant: str
    digest: Digest
    document: dict[str, Any]
    created_at: Time
    created_by: str


class LooserThan(Answer):
    """A gate before another one, and what is looser in that, in words."""

    gate: Digest
    looser: list[str]


class GateInLine(Gate):
    """A gate in its plant's line, in force or not, and what is looser in it than in the one before,
    in words; and than in every one."""

    in_force: bool
    follows: Digest | None = Field(
        description="The gate that was in force before; null for the first"
    )
    looser: list[str]
    looser_than: list[LooserThan] = Field(
        description="Each gate before it in which this one is looser, the newest first"
    )


class Job(Answer):
    """`progress` runs from 0 to 1. `result` is what came of it, or a problem with `code`, `detail`
    and `hint`. `operation` says whether it monitors, identifies parameters or corrects a model;
    nothing here adapts a control policy."""

    id: str
    plant: str
    kind: str
    request: dict[str, Any]
    state: str
    progress: float
    stage: str
    result: dict[str, Any] | None
    created_at: Time
    created_by: str
    updated_at: Time

    @computed_field  # type: ignore[prop-decorator]
    @property
    def operation(self) -> Operation:
        """Which of the four it is."""
        return of_job(self.kind, self.request)


class Output(Answer):
    """A file that a job left behind."""

    name: str
    digest: Digest
    size_bytes: int
    media_type: str


class JobWithReads(Job):
    """A job, the digest of everything it has read, and the files that it left behind."""

    reads: dict[str, str]
    outputs: list[Output]


class Evidence(Answer):
    """What was found of an artifact at a stage, with its scope."""

    plant: str
    digest: Digest
    artifact: Digest
    stage: str
    passed: bool
    document: dict[str, Any]
    job: str | None
    created_at: Time
    created_by: str


class ChannelDeclaration(BaseModel):
    """A channel of serving, and the stages whose passed evidence it requires."""

    model_config = ConfigDict(extra="forbid")
    name: str = Field(pattern=r"^[a-z0-9][a-z0-9_-]{0,62}$")
    requires: list[Literal["MIL", "SIL", "PIL", "HIL", "physical"]] = []


class Channel(Answer):
    plant: str
    name: str
    requires: list[str]
    created_at: Time
    created_by: str


class ChannelPosition(Answer):
    """What a channel serves, and the evidence that it rests on."""

    plant: str
    channel: str
    generation: int
    artifact: Digest
    version: int
    evidence: list[Digest]
    at: Time
    actor: str


class ChannelMove(BaseModel):
    """Serve an artifact on a channel, if the channel is still at `expected_generation`; 0 before
    its first."""

    model_config = ConfigDict(extra="forbid")
    artifact: Digest
    expected_generation: int = Field(ge=0, le=2**31 - 1)


class Policy(Answer):
    """What may happen without a person, from `created_at` on until the next one."""

    plant: str
    sequence: int
    digest: Digest
    document: dict[str, Any]
    created_at: Time
    created_by: str


class Monitor(Answer):
    """A calibrated monitor: its detectors with their levels, and what they were measured to
    keep."""

    plant: str
    digest: Digest
    artifact: Digest
    document: dict[str, Any]
    job: str | None
    created_at: Time
    created_by: str


class Watch(Answer):
    """What a monitor saw in one episode: of each detector its highest statistic, of each channel
    its error in healthy spreads."""

    sequence: int
    episode: Digest
    seen: dict[str, Any]
    at: Time


class Alarm(Answer):
    """`document` says which detectors alarmed, since when, and what changed; `job` is the diagnosis
    that it opened, once it could, `trial` the gate that judged what that made."""

    id: str
    plant: str
    monitor: Digest | None
    artifact: Digest
    episode: Digest
    document: dict[str, Any]
    job: str | None
    trial: str | None
    raised_at: Time
    closed_at: Time | None
    closed_by: str | None
    closed_because: str | None


class MonitorState(BaseModel):
    """Whether somebody watches. `watches` is false where no monitor was calibrated for what serves
    now: `hint` says what to do."""

    plant: str
    serving: Digest
    monitor: Digest | None
    watches: bool
    episodes: int
    alarm: Alarm | None
    hint: str


class Closing(BaseModel):
    """Why an alarm is closed."""

    model_config = ConfigDict(extra="forbid")
    because: str = Field(min_length=1, max_length=500, pattern=LINE)


class Decision(Answer):
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
        """What was known when the gate was declared."""
        return disclosure(self.document)


class Approval(Answer):
    plant: str
    decision: Digest
    token: str = Field(description="The approving token's public prefix")
    at: Time
    actor: str
    because: str | None = Field(None, description="Why, where it takes a reason")


class ApprovalRequest(BaseModel):
    """Why a decision is approved: a candidate that was rejected before takes a reason."""

    model_config = ConfigDict(extra="forbid")
    because: str | None = Field(None, min_length=1, max_length=2000, pattern=LINE)


class Serving(BaseModel):
    """Which artifact answers for a plant, since when, and by which decision; null for a
    registration."""

    plant: str
    version: int
    artifact: Digest
    generation: int
    since: Time
    decision: Digest | None
    move: Literal["registered", "promoted", "rolled_back"]
    actor: str


class AuditEntry(Answer):
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
    """A public key under which the log was signed; `endorsement` is the note in which the one
    before hands over to it."""

    verifier: str
    endorsement: str | None


class AuditKeys(BaseModel):
    """The keys of the log, in order; the last one signs."""

    items: list[AuditKey]


class Proof(BaseModel):
    """A proof of RFC 9162, in a log of `size` entries."""

    size: int
    hashes: list[str] = Field(description="base64, from the leaf up")


class Rows(BaseModel):
    """Rows of a table, all columns as they are stored; `next` goes into the next request's `after`,
    null at the end."""

    items: list[dict[str, Any]]
    next: str | None = None


class Envelope(BaseModel):
    """A signed document (DSSE 1.0): `payload` is its canonical JSON in base64."""

    payload: str
    payloadType: str  # noqa: N815  (the standard's name)
    signatures: list[dict[str, str]]


class FitRequest(BaseModel):
    """`episodes` are adaptation episodes by digest; null for all there are."""

    model_config = ConfigDict(extra="forbid")
    kind: Literal["fit"]
    method: Literal["identify", "residual"]
    episodes: list[Digest] | None = None
    features: list[str] | None = Field(
        None,
        description="residual only: features of the linear map, such as q, v, u, q*v, sign(v), 1",
    )
    penalty: float | None = Field(
        None, gt=0, allow_inf_nan=False, description="residual only: ridge penalty on every weight"
    )


class GateRequest(BaseModel):
    """Judge `candidate` against what serves now, under the gate in force; `episodes` are held-out
    ones, null for all there are."""

    model_config = ConfigDict(extra="forbid")
    kind: Literal["gate"]
    candidate: Digest
    gate: Digest
    episodes: list[Digest] | None = None
    scales: bool = Field(
        False, description="Also judge with each channel's reporting scale halved and doubled"
    )


class DiagnosisRequest(BaseModel):
    """Diagnose the gap of the plant's nominal model; `episodes` are adaptation and validation ones,
    null for all there are."""

    model_config = ConfigDict(extra="forbid")
    kind: Literal["diagnose"]
    episodes: list[Digest] | None = None
    seed: int = Field(0, ge=0, lt=2**32, description="of the resampling behind the intervals")


class BlindtrialRequest(BaseModel):
    """Hide effects in simulated machines after the plant and its episodes, diagnose them blindly,
    and say how often that was right."""

    model_config = ConfigDict(extra="forbid")
    kind: Literal["blindtrial"]
    trials: int = Field(
        60, ge=1, le=2000, description="machines to draw; each takes as long as a diagnosis"
    )
    episodes: list[Digest] | None = None


class ValidationRequest(BaseModel):
    """Compare what serves now on what was held out since its promotion with how right it was
    then."""

    model_config = ConfigDict(extra="forbid")
    kind: Literal["validate"]


class RecomputationRequest(BaseModel):
    """Make a decision anew from its gate, its artifacts and its episodes, and say whether that
    agrees with what was recorded."""

    model_config = ConfigDict(extra="forbid")
    kind: Literal["recompute"]
    decision: Digest


class ComparisonRequest(BaseModel):
    """Roll two versions out on the same episodes, null for all that were held out; of one episode
    an MCAP with both is left behind."""

    model_config = ConfigDict(extra="forbid")
    kind: Literal["compare"]
    first: Digest
    second: Digest
    episodes: list[Digest] | None = None


class CalibrationRequest(BaseModel):
    """Calibrate a monitor of what serves now. `episodes` are healthy ones, null for all of the role
    reference."""

    model_config = ConfigDict(extra="forbid")
    kind: Literal["calibrate"]
    promise_h: float = Field(
        100.0,
        gt=0,
        allow_inf_nan=False,
        description="operating hours in which one false alarm is allowed, of all joints",
    )
    detectors: list[str] | None = Field(
        None,
        description=(
            "which detectors share the promise; null for all that the reference is long enough for"
        ),
    )
    episodes: list[Digest] | None = None
    seed: int = Field(0, ge=0, lt=2**32, description="of the resampling")


class Promotion(BaseModel):
    """Serve the decision's candidate, if the pointer is still at `expected_generation`."""

    model_config = ConfigDict(extra="forbid")
    decision: Digest
    expected_generation: int = Field(ge=1, le=2**31 - 1)


class Rollback(BaseModel):
    """Serve what served before, if the pointer is still at `expected_generation`."""

    model_config = ConfigDict(extra="forbid")
    expected_generation: int = Field(ge=1, le=2**31 - 1)


class Health(BaseModel):
    status: str
    version: str


class Readiness(BaseModel):
    ready: bool
    checks: dict[str, str]


EpisodeContext.model_rebuild()
