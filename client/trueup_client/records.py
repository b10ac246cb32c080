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
    """A registered plant with its description."""

    name: str
    digest: str
    document: Document
    created_at: str
    created_by: str
    project: str | None


class Episode(TypedDict):
    """An ingested episode."""

    plant: str
    digest: str
    size_bytes: int
    role: str
    summary: Document
    created_at: str
    created_by: str


class EpisodeContext(Episode):
    """An episode with what was serving while it was recorded, and how many jobs of each kind
    have read it.
    """

    served: list[Document]
    uses: Document


class Artifact(TypedDict):
    """A version of a plant's model."""

    plant: str
    version: int
    digest: str
    kind: str
    arrays: str | None
    job: str | None
    created_at: str
    created_by: str


class Gate(TypedDict):
    """A gate. The last one of a plant judges, and its document names the gate that it follows
    and why.
    """

    plant: str
    digest: str
    document: Document
    created_at: str
    created_by: str


class LooserThan(TypedDict):
    """An earlier gate, and in words what is looser in the later one."""

    gate: str
    looser: list[str]


class GateInLine(Gate):
    """A gate with its place among the gates of its plant: whether it is in force, and in words
    what is looser in it than in the gate before and in each earlier one.
    """

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
    """A job. `progress` runs from 0 to 1. `result` is the result, or a problem with `code`,
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


class QueuedJob(Job):
    """A job that has not ended: the worker that runs it and since when, how many jobs were
    submitted before it and have not ended, and how long it still waits and such jobs take,
    about [s]; null where nothing is known of such jobs.
    """

    worker: str | None
    begun_at: str | None
    ahead: int
    waits_s: float | None
    takes_s: float | None


class JobWithReads(Job):
    """A job, the digests of everything that it has read and for what, and the files that it left
    behind.
    """

    reads: Document
    outputs: list[Output]


class Decision(TypedDict):
    """A decision of a gate on a candidate, with every figure in `document`."""

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
    """An approval of a decision for promotion."""

    plant: str
    decision: str
    token: str
    at: str
    actor: str
    because: str | None


class Evidence(TypedDict):
    """Evidence of an artifact at a stage of the test ladder, with its scope."""

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
    """A channel of serving, and the stages whose passed evidence it requires."""

    plant: str
    name: str
    requires: list[str]
    created_at: str
    created_by: str


class ChannelPosition(TypedDict):
    """What a channel serves, and the evidence that allowed it."""

    plant: str
    channel: str
    generation: int
    artifact: str
    version: int
    evidence: list[str]
    at: str
    actor: str


class Policy(TypedDict):
    """An update policy: what may happen without a person. It is in force from `created_at` until
    the next one.
    """

    plant: str
    sequence: int
    digest: str
    document: Document
    created_at: str
    created_by: str


class Monitor(TypedDict):
    """A calibrated monitor: its detectors with their levels, and the promise that they were
    measured to keep.
    """

    plant: str
    digest: str
    artifact: str
    document: Document
    job: str | None
    created_at: str
    created_by: str


class Watch(TypedDict):
    """What a monitor saw in one episode: the highest statistic of each detector, and the error
    of each channel in healthy spreads.
    """

    sequence: int
    episode: str
    seen: Document
    at: str


class Alarm(TypedDict):
    """An alarm. `document` says which detectors alarmed, since when, and what changed. `job` is
    the diagnosis that it opened, and `trial` the trial of the model that the diagnosis made.
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
    """Whether a monitor watches the model that serves. Where none was calibrated for it,
    `watches` is false and `hint` says what to do.
    """

    plant: str
    serving: str
    monitor: str | None
    watches: bool
    episodes: int
    alarm: Alarm | None
    hint: str


class Project(TypedDict):
    """A project."""

    name: str
    created_at: str
    created_by: str


class Token(TypedDict):
    """A token, without its secret. It sees one project or plant, or all where these are null."""

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


class IssuedToken(Token):
    """A token that was issued now, with its secret."""

    token: str


class Webhook(TypedDict):
    """A webhook, without its URL and secret, and how it is doing."""

    name: str
    host: str
    form: str
    events: list[str]
    project: str | None
    plant: str | None
    created_at: str
    created_by: str
    removed_at: str | None
    removed_by: str | None
    state: str
    sent: int
    attempts: int
    problem: str | None
    failing_since: str | None
    due_at: str | None


class DeclaredWebhook(Webhook):
    """A webhook that was declared now, with its secret."""

    secret: str


class Label(TypedDict):
    """What people call something of a plant. `subject` is the name of the plant, or the digest
    of an episode, an artifact or a decision; `updated_at` is empty where nobody has labelled
    it.
    """

    plant: str
    kind: str
    subject: str
    name: str | None
    tags: list[str]
    note: str | None
    updated_at: str
    updated_by: str


class Identity(TypedDict):
    """Who asks, with which roles, and which project or plant the token sees, null for all."""

    name: str
    roles: list[str]
    project: str | None
    plant: str | None


class AuditEntry(TypedDict):
    """An entry of the audit log: who did what to which subject, when."""

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
