"""One frozen record for each noun of the registry. Its fields are the columns of its table."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

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
    """What the holder of a token may do."""

    ROBOT = "robot"
    ENGINEER = "engineer"
    OPERATOR = "operator"
    AUDITOR = "auditor"
    ADMIN = "admin"


@dataclass(frozen=True, slots=True)
class ProjectRecord:
    """A project. Its plants are visible to its own tokens and to those of all projects."""

    name: str
    created_at: str
    created_by: str


@dataclass(frozen=True, slots=True)
class TokenRecord:
    """A token: its public prefix and the digest of its secret.

    It sees one project, or all where `project` is None, and of these one plant, or all where
    `plant` is None.
    """

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
    """An approval of a decision for promotion, with the reason where one is needed."""

    plant: str
    decision: str
    token: str
    at: str
    actor: str
    because: str | None = None


@dataclass(frozen=True, slots=True)
class WebhookRecord:
    """A declared webhook: which events go to which host, in which form; of one project or plant, or
    of all where these are None. `target_digest` is the digest of its URL."""

    name: str
    host: str
    target_digest: str
    form: str
    events: list[str]
    project: str | None
    plant: str | None
    created_at: str
    created_by: str
    removed_at: str | None = None
    removed_by: str | None = None


@dataclass(frozen=True, slots=True)
class HeldPlant:
    """A plant whose event a webhook refused: how often in a row, and when it is sent again."""

    attempts: int
    due_at: str


@dataclass(frozen=True, slots=True)
class WebhookCursor:
    """Where a webhook stands. Everything in the log up to `sent`, and the entries `sent_beyond`,
    have been sent or are of no interest to it.

    `entry` is the engine's entry of the delivery under way, and `held` the plants that wait by
    themselves. Of a webhook that fails there are the failed `attempts` in a row, since when, when
    the next one is due, and the last `problem`.
    """

    webhook: str
    url: str
    secret: str
    sent: int
    sent_beyond: list[int]
    held: dict[str, Json] = field(default_factory=dict)
    entry: str | None = None
    attempts: int = 0
    failing_since: str | None = None
    due_at: str | None = None
    problem: str | None = None
    stopped_at: str | None = None

    def held_plants(self) -> dict[str, HeldPlant]:
        """The plants that wait by themselves, by name; what is of no plant has an empty one."""
        held: Any = self.held
        return {plant: HeldPlant(of["attempts"], of["due_at"]) for plant, of in held.items()}


@dataclass(frozen=True, slots=True)
class PlantRecord:
    """A registered plant. Where it belongs to no project, only tokens of all projects see it."""

    name: str
    digest: str
    document: dict[str, Json]
    created_at: str
    created_by: str
    project: str | None = None


@dataclass(frozen=True, slots=True)
class EpisodeRecord:
    """An ingested episode. Its bytes are the blob of its digest.

    `samples_digest` is the digest of the recorded samples, which two files of different bytes may
    share. It is None for an episode from before samples had a digest.
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
    """A job. `result` is set once the state is final: the result, or the problem."""

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
        """Whether the job monitors, identifies parameters, corrects a model, or adapts a policy."""
        return of_job(self.kind, self.request)


@dataclass(frozen=True, slots=True)
class OutputRecord:
    """A file that a job left behind. Its bytes are the blob of its digest."""

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
    """Where an imported plant came from: the archive, the checkpoint of its log, and the blob that
    holds its entries with their proofs."""

    plant: str
    archive: str
    origin: str
    checkpoint: str
    entries: str
    at: str
    actor: str


@dataclass(frozen=True, slots=True)
class AuditKey:
    """A public key that signed the log, and the note in which the key before endorses it, None for
    the first."""

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
    """Which monitor watches a plant since when, how many episodes it has seen, and the state of its
    detectors (`kept`)."""

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
    """An alarm: which monitor raised it on which episode, and what changed.

    `monitor` is None where a scheduled validation raised it. `job` is the diagnosis that it opened,
    and `trial` the trial of the model that the diagnosis made.
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
    """An update policy. The last one of a plant is in force."""

    plant: str
    sequence: int
    digest: str
    document: dict[str, Json]
    created_at: str
    created_by: str


@dataclass(frozen=True, slots=True)
class EvidenceRecord:
    """Evidence of an artifact at a stage of the test ladder."""

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
    """A channel of serving, and the stages whose passed evidence it requires of an artifact."""

    plant: str
    name: str
    requires: list[str]
    created_at: str
    created_by: str


@dataclass(frozen=True, slots=True)
class ChannelMove:
    """One position of a channel, and the digests of the evidence that allowed it."""

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
    """One position of a serving pointer. `back_to` is the generation to whose artifact a rollback
    returns."""

    plant: str
    generation: int
    kind: str
    artifact: str
    version: int
    decision: str | None
    back_to: int | None
    at: str
    actor: str
