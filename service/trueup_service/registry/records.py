"""What the registry answers with: one frozen record for each noun."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from trueup.canonical import Json
from trueup.ledger.operation import Operation, of_job


class JobState(StrEnum):
    """Where a job stands. The last three are final."""

    QUEUED = "queued"
    RUNNING = "running"
    CANCELLING = "cancelling"
    SUCCEEDED = "succeeded"
    FAILED = "failed"
    CANCELLED = "cancelled"


FINAL = (JobState.SUCCEEDED, JobState.FAILED, JobState.CANCELLED)
NOTHING_CAME = (JobState.FAILED, JobState.CANCELLED)


class MoveKind(StrEnum):
    """Why a serving pointer moved."""

    REGISTERED = "registered"
    PROMOTED = "promoted"
    ROLLED_BACK = "rolled_back"


class Role(StrEnum):
    """What somebody is here to do."""

    ROBOT = "robot"
    ENGINEER = "engineer"
    OPERATOR = "operator"
    AUDITOR = "auditor"
    ADMIN = "admin"


@dataclass(frozen=True, slots=True)
class ProjectRecord:
    """A project: plants that only its own tokens, and those of all projects, know of."""

    name: str
    created_at: str
    created_by: str


@dataclass(frozen=True, slots=True)
class TokenRecord:
    """A token by its public prefix and the digest of its secret; of one project, or of all; of one
    plant, or of all of those."""

    prefix: str
    digest: str
    name: str
    roles: list[str]
    project: str | None
    plant: str | None
    created_at: str
    created_by: str
    expires_at: str | None
    revoked_at: str | None = None
    revoked_by: str | None = None


@dataclass(frozen=True, slots=True)
class Approval:
    """That somebody wants a decision promoted, and why, where it takes a reason."""

    plant: str
    decision: str
    token: str
    at: str
    actor: str
    because: str | None = None


@dataclass(frozen=True, slots=True)
class PlantRecord:
    """A registered plant; without a project it belongs to none, and only tokens of all projects see
    it."""

    name: str
    digest: str
    document: dict[str, Json]
    created_at: str
    created_by: str
    project: str | None = None


@dataclass(frozen=True, slots=True)
class EpisodeRecord:
    """An ingested episode; its bytes are the blob of its digest, and `samples_digest` names what
    was recorded, whatever the bytes are.

    An episode that came in before samples were named has none.
    """

    plant: str
    digest: str
    size_bytes: int
    role: str
    start_ns: int
    end_ns: int
    summary: dict[str, Json]
    created_at: str
    created_by: str
    samples_digest: str | None = None


@dataclass(frozen=True, slots=True)
class ArtifactRecord:
    """A version of a plant's model."""

    plant: str
    version: int
    digest: str
    kind: str
    manifest: str
    arrays: str | None
    job: str | None
    created_at: str
    created_by: str


@dataclass(frozen=True, slots=True)
class GateRecord:
    """A gate, frozen by its digest."""

    plant: str
    digest: str
    document: dict[str, Json]
    created_at: str
    created_by: str


@dataclass(frozen=True, slots=True)
class JobRecord:
    """Work that was asked for. `result` is set once the state is final: what came of it, or the
    problem."""

    id: str
    plant: str
    kind: str
    request: dict[str, Json]
    state: str
    progress: float
    stage: str
    result: dict[str, Json] | None
    created_at: str
    created_by: str
    updated_at: str

    @property
    def operation(self) -> Operation:
        """Which of the four it is."""
        return of_job(self.kind, self.request)


@dataclass(frozen=True, slots=True)
class OutputRecord:
    """A file that a job left behind; its bytes are the blob of its digest."""

    plant: str
    job: str
    name: str
    digest: str
    size_bytes: int
    media_type: str


@dataclass(frozen=True, slots=True)
class DecisionRecord:
    """A gate's decision."""

    digest: str
    plant: str
    gate: str
    candidate: str
    incumbent: str
    generation: int
    accepted: bool
    document: dict[str, Json]
    job: str | None
    created_at: str
    created_by: str


@dataclass(frozen=True, slots=True)
class ImportRecord:
    """Where an imported plant came from: the archive, the head of its log, and the blob of its
    entries, each with its proof."""

    plant: str
    archive: str
    origin: str
    checkpoint: str
    entries: str
    at: str
    actor: str


@dataclass(frozen=True, slots=True)
class AuditKey:
    """A public key under which the log was signed, and the note in which the one before handed over
    to it."""

    verifier: str
    endorsement: str | None


@dataclass(frozen=True, slots=True)
class MonitorRecord:
    """A calibrated monitor of one artifact."""

    plant: str
    digest: str
    artifact: str
    document: dict[str, Json]
    job: str | None
    created_at: str
    created_by: str


@dataclass(frozen=True, slots=True)
class Watching:
    """Which monitor watches a plant since when, how many episodes it has seen, and what its
    detectors have kept of them."""

    plant: str
    monitor: str
    since: str
    sequence: int
    kept: dict[str, Json]


@dataclass(frozen=True, slots=True)
class Watch:
    """What a monitor saw in one episode."""

    plant: str
    monitor: str
    sequence: int
    episode: str
    seen: dict[str, Json]
    at: str


@dataclass(frozen=True, slots=True)
class AlarmRecord:
    """An alarm: which monitor raised it, None for a scheduled validation, on which episode, what
    changed, the diagnosis that it opened, the trial of what that made, and why it was closed.
    """

    id: str
    plant: str
    monitor: str | None
    artifact: str
    episode: str
    document: dict[str, Json]
    job: str | None
    trial: str | None
    raised_at: str
    closed_at: str | None
    closed_by: str | None
    closed_because: str | None


@dataclass(frozen=True, slots=True)
class PolicyRecord:
    """An update policy; a plant's last one holds."""

    plant: str
    sequence: int
    digest: str
    document: dict[str, Json]
    created_at: str
    created_by: str


@dataclass(frozen=True, slots=True)
class EvidenceRecord:
    """What was found of an artifact at a stage."""

    plant: str
    digest: str
    artifact: str
    stage: str
    passed: bool
    document: dict[str, Json]
    job: str | None
    created_at: str
    created_by: str


@dataclass(frozen=True, slots=True)
class ChannelRecord:
    """A channel of serving, and the stages whose evidence it requires of what it serves."""

    plant: str
    name: str
    requires: list[str]
    created_at: str
    created_by: str


@dataclass(frozen=True, slots=True)
class ChannelMove:
    """One position of a channel, and the evidence that it rests on, by digest."""

    plant: str
    channel: str
    generation: int
    artifact: str
    version: int
    evidence: list[str]
    at: str
    actor: str


@dataclass(frozen=True, slots=True)
class Move:
    """One position of a serving pointer. `back_to` is the generation whose artifact a rollback
    would serve."""

    plant: str
    generation: int
    kind: str
    artifact: str
    version: int
    decision: str | None
    back_to: int | None
    at: str
    actor: str
