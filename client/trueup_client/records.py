"""The service's answers as types. Made by tools/make_records.py from its OpenAPI."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypedDict

Document = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Serving:
    """Which artifact answers for a plant. `generation` only grows; `since` is UTC, ISO 8601."""

    plant: str
    version: int
    artifact: str
    generation: int
    since: str
    decision: str | None
    move: str
    actor: str


class Plant(TypedDict):
    """Plant, as the service keeps it."""

    name: str
    digest: str
    document: Document
    created_at: str
    created_by: str
    project: str | None


class Episode(TypedDict):
    """Episode, as the service keeps it."""

    plant: str
    digest: str
    size_bytes: int
    role: str
    summary: Document
    created_at: str
    created_by: str


class EpisodeContext(TypedDict):
    """An episode joined to what was serving while it was recorded, and how often it was used."""

    plant: str
    digest: str
    size_bytes: int
    role: str
    summary: Document
    created_at: str
    created_by: str
    served: list[Document]
    uses: Document


class Artifact(TypedDict):
    """Artifact, as the service keeps it."""

    plant: str
    version: int
    digest: str
    kind: str
    arrays: str | None
    job: str | None
    created_at: str
    created_by: str


class Gate(TypedDict):
    """A gate. A plant's last one judges; its document names the one that it follows, and why."""

    plant: str
    digest: str
    document: Document
    created_at: str
    created_by: str


class LooserThan(TypedDict):
    """A gate before another one, and what is looser in that, in words."""

    gate: str
    looser: list[str]


class GateInLine(TypedDict):
    """A gate in its plant's line, in force or not, and what is looser in it than in the one
    before, in words; and than in every one.
    """

    plant: str
    digest: str
    document: Document
    created_at: str
    created_by: str
    in_force: bool
    follows: str | None
    looser: list[str]
    looser_than: list[LooserThan]


class Output(TypedDict):
    """A file that a job left behind."""

    name: str
    digest: str
    size_bytes: int
    media_type: str


class Job(TypedDict):
    """`progress` runs from 0 to 1. `result` is what came of it, or a problem with `code`,
    `detail` and `hint`. `operation` says whether it monitors, identifies parameters or
    corrects a model; nothing here adapts a control policy.
    """

    id: str
    plant: str
    kind: str
    request: Document
    state: str
    progress: float
    stage: str
    result: Document | None
    created_at: str
    created_by: str
    updated_at: str
    operation: str


class JobWithReads(TypedDict):
    """A job, the digest of everything it has read, and the files that it left behind."""

    id: str
    plant: str
    kind: str
    request: Document
    state: str
    progress: float
    stage: str
    result: Document | None
    created_at: str
    created_by: str
    updated_at: str
    reads: Document
    outputs: list[Output]
    operation: str


class Decision(TypedDict):
    """Decision, as the service keeps it."""

    digest: str
    plant: str
    gate: str
    candidate: str
    incumbent: str
    generation: int
    accepted: bool
    document: Document
    job: str | None
    created_at: str
    created_by: str
    disclosure: str | None


class Approval(TypedDict):
    """Approval, as the service keeps it."""

    plant: str
    decision: str
    token: str
    at: str
    actor: str
    because: str | None


class Evidence(TypedDict):
    """What was found of an artifact at a stage, with its scope."""

    plant: str
    digest: str
    artifact: str
    stage: str
    passed: bool
    document: Document
    job: str | None
    created_at: str
    created_by: str


class Channel(TypedDict):
    """Channel, as the service keeps it."""

    plant: str
    name: str
    requires: list[str]
    created_at: str
    created_by: str


class ChannelPosition(TypedDict):
    """What a channel serves, and the evidence that it rests on."""

    plant: str
    channel: str
    generation: int
    artifact: str
    version: int
    evidence: list[str]
    at: str
    actor: str


class Policy(TypedDict):
    """What may happen without a person, from `created_at` on until the next one."""

    plant: str
    sequence: int
    digest: str
    document: Document
    created_at: str
    created_by: str


class Monitor(TypedDict):
    """A calibrated monitor: its detectors with their levels, and what they were measured to
    keep.
    """

    plant: str
    digest: str
    artifact: str
    document: Document
    job: str | None
    created_at: str
    created_by: str


class Watch(TypedDict):
    """What a monitor saw in one episode: of each detector its highest statistic, of each
    channel its error in healthy spreads.
    """

    sequence: int
    episode: str
    seen: Document
    at: str


class Alarm(TypedDict):
    """`document` says which detectors alarmed, since when, and what changed; `job` is the
    diagnosis that it opened, once it could, `trial` the gate that judged what that made.
    """

    id: str
    plant: str
    monitor: str | None
    artifact: str
    episode: str
    document: Document
    job: str | None
    trial: str | None
    raised_at: str
    closed_at: str | None
    closed_by: str | None
    closed_because: str | None


class MonitorState(TypedDict):
    """Whether somebody watches. `watches` is false where no monitor was calibrated for what
    serves now: `hint` says what to do.
    """

    plant: str
    serving: str
    monitor: str | None
    watches: bool
    episodes: int
    alarm: Alarm | None
    hint: str


class Project(TypedDict):
    """Project, as the service keeps it."""

    name: str
    created_at: str
    created_by: str


class Token(TypedDict):
    """Token, as the service keeps it."""

    prefix: str
    name: str
    roles: list[str]
    project: str | None
    plant: str | None
    created_at: str
    created_by: str
    expires_at: str | None
    revoked_at: str | None
    revoked_by: str | None


class IssuedToken(TypedDict):
    """IssuedToken, as the service keeps it."""

    prefix: str
    name: str
    roles: list[str]
    project: str | None
    plant: str | None
    created_at: str
    created_by: str
    expires_at: str | None
    revoked_at: str | None
    revoked_by: str | None
    token: str


class Identity(TypedDict):
    """Who asks, and what there is for them: null for all projects, or all plants."""

    name: str
    roles: list[str]
    project: str | None
    plant: str | None


class AuditEntry(TypedDict):
    """AuditEntry, as the service keeps it."""

    sequence: int
    at: str
    kind: str
    actor: str
    plant: str | None
    subject: str
    facts: Document
    rows: Document


class Envelope(TypedDict):
    """A signed document (DSSE 1.0): `payload` is its canonical JSON in base64."""

    payload: str
    payloadType: str
    signatures: list[Document]
