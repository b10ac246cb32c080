"""The client for an event loop: the methods of `Client`, to be awaited or iterated over.

    async with AsyncClient("http://127.0.0.1:8321") as client:
        serving = await client.serving("emps")
        async for moved in client.watch("emps"):
            ...

Made by tools/make_async_client.py from the client itself.
"""

from __future__ import annotations

import os
from collections.abc import AsyncIterator, Callable
from pathlib import Path

from trueup_client.client import Client, Share, silent
from trueup_client.pool import Pool
from trueup_client.proof import Checkpoint
from trueup_client.records import (
    Alarm,
    Approval,
    Artifact,
    AuditEntry,
    Channel,
    ChannelPosition,
    Decision,
    Document,
    Envelope,
    Episode,
    EpisodeContext,
    Evidence,
    Gate,
    GateInLine,
    Identity,
    IssuedToken,
    Job,
    JobWithReads,
    Monitor,
    MonitorState,
    Plant,
    Policy,
    Project,
    Serving,
    Token,
    Watch,
)
from trueup_client.witness import Witness


class AsyncClient:
    """Talks to one service, with at most `at_once` requests on their way.

    The other arguments are those of `Client`.

    `progress` and `confirmed` are called in the thread that asks. A call that is cancelled is
    broken off, and what it asked for may have been done: ask, or repeat it with its key. A watch
    holds one of the requests for as long as it lasts.
    """

    def __init__(
        self,
        url: str | None = None,
        actor: str | None = None,
        timeout_s: float = 120.0,
        token: str | None = None,
        *,
        at_once: int = 8,
    ) -> None:
        self._pool = Pool(lambda: Client(url, actor, timeout_s, token), at_once)

    async def __aenter__(self) -> AsyncClient:
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    async def close(self) -> None:
        """Close every connection; what still asks or waits for its turn ends with Unreachable."""
        await self._pool.close()

    async def register_plant(self, document: Document, project: str | None = None) -> Plant:
        """Register a plant by the content of its plant.json; registering it again changes
        nothing."""
        return await self._pool.run(Client.register_plant, document, project)

    async def plant(self, name: str) -> Plant:
        return await self._pool.run(Client.plant, name)

    def plants(self) -> AsyncIterator[Plant]:
        return self._pool.each(Client.plants)

    async def upload_episode(
        self, plant: str, path: str | os.PathLike[str], progress: Share = silent
    ) -> Episode:
        """Upload an MCAP file, streamed, with its digest; the same file again is the same episode.

        A long one goes in parts: where the line breaks it goes on from what came, in this call or
        the next.
        """
        return await self._pool.run(Client.upload_episode, plant, path, progress)

    def episodes(self, plant: str, role: str | None = None) -> AsyncIterator[Episode]:
        return self._pool.each(Client.episodes, plant, role)

    async def episode(self, plant: str, digest: str) -> EpisodeContext:
        """An episode, with what was serving while it was recorded."""
        return await self._pool.run(Client.episode, plant, digest)

    async def download_episode(self, plant: str, digest: str, path: str | os.PathLike[str]) -> None:
        """Save an episode's bytes. Raises DigestMismatch if they are not what the digest names."""
        return await self._pool.run(Client.download_episode, plant, digest, path)

    def artifacts(self, plant: str) -> AsyncIterator[Artifact]:
        return self._pool.each(Client.artifacts, plant)

    async def artifact(self, plant: str, digest: str) -> Artifact:
        return await self._pool.run(Client.artifact, plant, digest)

    async def manifest_digest(self, plant: str, digest: str) -> str:
        """SHA-256 of the manifest that the service keeps under this digest."""
        return await self._pool.run(Client.manifest_digest, plant, digest)

    async def version(self, plant: str, version: int) -> Artifact:
        return await self._pool.run(Client.version, plant, version)

    async def add_artifact(self, plant: str, manifest: bytes, arrays: bytes = b"") -> Artifact:
        """Add a version: first its arrays under their digest, then the manifest's exact bytes."""
        return await self._pool.run(Client.add_artifact, plant, manifest, arrays)

    async def fetch(self, plant: str, digest: str, folder: str | os.PathLike[str]) -> Path:
        """Fetch an artifact into a folder as manifest.json and arrays.safetensors, every byte
        verified. Raises DigestMismatch."""
        return await self._pool.run(Client.fetch, plant, digest, folder)

    async def declare_gate(self, plant: str, document: Document | None = None) -> Gate:
        """Declare a gate before anything is scored by it; without a document the one in force, or
        where there is none the default.

        Once a candidate was judged, another gate names the one in force in `follows` and says why
        in `because`.
        """
        return await self._pool.run(Client.declare_gate, plant, document)

    async def gate_in_force(self, plant: str) -> GateInLine:
        """The gate that judges, and what is looser in it than in the one before."""
        return await self._pool.run(Client.gate_in_force, plant)

    async def gate_in_line(self, plant: str, digest: str) -> GateInLine:
        """A gate, whether it is in force, and what is looser in it than in the one before."""
        return await self._pool.run(Client.gate_in_line, plant, digest)

    def gates(self, plant: str) -> AsyncIterator[Gate]:
        """Every gate of a plant, by digest."""
        return self._pool.each(Client.gates, plant)

    async def gate(self, plant: str, digest: str) -> Gate:
        return await self._pool.run(Client.gate, plant, digest)

    async def submit(self, plant: str, request: Document, key: str | None = None) -> Job:
        """Submit a job, such as {"kind": "fit", "method": "identify"} or {"kind": "gate",
        "candidate": …, "gate": …}.

        With a `key` of your own the same request is the same job, also from another process, for as
        long as the service remembers keys.
        """
        return await self._pool.run(Client.submit, plant, request, key)

    def jobs(self, plant: str) -> AsyncIterator[Job]:
        """Jobs of a plant, the newest first."""
        return self._pool.each(Client.jobs, plant)

    async def job(self, job: str) -> JobWithReads:
        return await self._pool.run(Client.job, job)

    async def wait(
        self, job: str, progress: Callable[[JobWithReads], None] = lambda _: None
    ) -> JobWithReads:
        """The job once it is final, `progress` called with it meanwhile. Raises Problem if it
        failed or was cancelled."""
        return await self._pool.run(Client.wait, job, progress)

    async def cancel(self, job: str) -> Job:
        return await self._pool.run(Client.cancel, job)

    def decisions(self, plant: str) -> AsyncIterator[Decision]:
        return self._pool.each(Client.decisions, plant)

    async def decision(self, plant: str, digest: str) -> Decision:
        return await self._pool.run(Client.decision, plant, digest)

    async def approve(self, plant: str, decision: str, because: str | None = None) -> Approval:
        """Approve a decision, where a promotion takes two people; of a candidate that was rejected
        before it takes a reason."""
        return await self._pool.run(Client.approve, plant, decision, because)

    async def find_decision(self, digest: str) -> Decision:
        """A decision of whichever plant."""
        return await self._pool.run(Client.find_decision, digest)

    async def serving(self, plant: str) -> Serving:
        """What serves now."""
        return await self._pool.run(Client.serving, plant)

    def watch(
        self, plant: str, wait_s: float = 30.0, confirmed: Callable[[], None] = lambda: None
    ) -> AsyncIterator[Serving]:
        """What serves now, then again at each move, for ever; each look waits up to `wait_s` [s] at
        the service.

        A service that is away is asked again, ever less often; the watch goes on where it was.
        `confirmed` is called at every answer, also where nothing has changed. Raises Problem for a
        refusal.
        """
        return self._pool.each(Client.watch, plant, wait_s, confirmed)

    def watch_channel(
        self,
        plant: str,
        channel: str,
        wait_s: float = 30.0,
        confirmed: Callable[[], None] = lambda: None,
    ) -> AsyncIterator[ChannelPosition]:
        """The same of a channel, which must have served something."""
        return self._pool.each(Client.watch_channel, plant, channel, wait_s, confirmed)

    def history(self, plant: str) -> AsyncIterator[Serving]:
        """Every position of the pointer, in order."""
        return self._pool.each(Client.history, plant)

    async def served_at(self, plant: str, at: str) -> Serving | None:
        """What was live at a time: UTC, ISO 8601, ending in Z."""
        return await self._pool.run(Client.served_at, plant, at)

    async def promote(
        self, plant: str, decision: str, expected_generation: int, key: str | None = None
    ) -> Serving:
        """Serve the candidate of an accepted decision, if the pointer has not moved since; once
        under a `key` of your own."""
        return await self._pool.run(Client.promote, plant, decision, expected_generation, key)

    async def roll_back(
        self, plant: str, expected_generation: int, key: str | None = None
    ) -> Serving:
        """Serve what served before, after its switchback test; once under a `key` of your own."""
        return await self._pool.run(Client.roll_back, plant, expected_generation, key)

    async def serving_envelope(self, plant: str) -> Envelope:
        """What serves, signed: `Robot` verifies it."""
        return await self._pool.run(Client.serving_envelope, plant)

    async def add_evidence(self, plant: str, document: Document) -> Evidence:
        """Add what was found of an artifact at a stage: artifact, stage, passed, shows,
        cannot_show, figures."""
        return await self._pool.run(Client.add_evidence, plant, document)

    async def evidence(self, plant: str, artifact: str) -> list[Evidence]:
        """Everything that was found of an artifact, in order."""
        return await self._pool.run(Client.evidence, plant, artifact)

    async def declare_channel(self, plant: str, name: str, requires: list[str]) -> Channel:
        """Declare a channel of serving that requires passed evidence of these stages."""
        return await self._pool.run(Client.declare_channel, plant, name, requires)

    def channels(self, plant: str) -> AsyncIterator[Channel]:
        return self._pool.each(Client.channels, plant)

    async def channel_serving(self, plant: str, channel: str) -> ChannelPosition:
        """What a channel serves now."""
        return await self._pool.run(Client.channel_serving, plant, channel)

    async def move_channel(
        self, plant: str, channel: str, artifact: str, expected_generation: int
    ) -> ChannelPosition:
        """Serve an artifact on a channel, if the channel has not moved since; its first move
        expects generation 0."""
        return await self._pool.run(
            Client.move_channel, plant, channel, artifact, expected_generation
        )

    async def declare_policy(self, plant: str, document: Document) -> Policy:
        """Declare what may happen without a person; it holds from then on."""
        return await self._pool.run(Client.declare_policy, plant, document)

    async def policy(self, plant: str) -> Policy:
        """The update policy that holds."""
        return await self._pool.run(Client.policy, plant)

    async def send_telemetry(self, plant: str, batch: Document) -> Episode:
        """Send a live batch: `start_ns` as text, `t_s`, `observations` and `commands` by channel;
        it becomes an episode that is watched."""
        return await self._pool.run(Client.send_telemetry, plant, batch)

    async def monitor(self, plant: str) -> MonitorState:
        """Whether the model that serves is watched, and the alarm that is open."""
        return await self._pool.run(Client.monitor, plant)

    def monitors(self, plant: str) -> AsyncIterator[Monitor]:
        """Every monitor there was, the newest first, each with its calibration."""
        return self._pool.each(Client.monitors, plant)

    def watches(self, plant: str, monitor: str) -> AsyncIterator[Watch]:
        """What a monitor saw, episode by episode."""
        return self._pool.each(Client.watches, plant, monitor)

    def alarms(self, plant: str) -> AsyncIterator[Alarm]:
        """Every alarm, the newest first."""
        return self._pool.each(Client.alarms, plant)

    async def alarm(self, plant: str, alarm: str) -> Alarm:
        return await self._pool.run(Client.alarm, plant, alarm)

    async def close_alarm(self, plant: str, alarm: str, because: str) -> Alarm:
        """Close an alarm, and say why; the next one may then be raised."""
        return await self._pool.run(Client.close_alarm, plant, alarm, because)

    async def whoami(self) -> Identity:
        """Whom the service takes this client for: name, roles, project, plant."""
        return await self._pool.run(Client.whoami)

    async def create_project(self, name: str) -> Project:
        return await self._pool.run(Client.create_project, name)

    def projects(self) -> AsyncIterator[Project]:
        return self._pool.each(Client.projects)

    async def issue_token(
        self,
        name: str,
        roles: list[str],
        project: str | None = None,
        plant: str | None = None,
        days: float | None = 365.0,
    ) -> IssuedToken:
        """Issue a token; `token` of the answer is shown this once. Not repeated where the answer
        was lost: revoke it, issue another."""
        return await self._pool.run(Client.issue_token, name, roles, project, plant, days)

    def tokens(self) -> AsyncIterator[Token]:
        return self._pool.each(Client.tokens)

    async def revoke_token(self, prefix: str) -> Token:
        """Revoke a token, for good."""
        return await self._pool.run(Client.revoke_token, prefix)

    def audit(self, plant: str | None = None, after: int = 0) -> AsyncIterator[AuditEntry]:
        """Every entry of the log, in order, from behind one."""
        return self._pool.each(Client.audit, plant, after)

    async def audit_key(self) -> str:
        """The log's public key, as the service gives it: keep it."""
        return await self._pool.run(Client.audit_key)

    async def endorsements(self) -> list[str]:
        """The notes by which keys of the log handed over to the next, in order."""
        return await self._pool.run(Client.endorsements)

    async def checkpoint(self) -> str:
        """The log's signed head, as a note."""
        return await self._pool.run(Client.checkpoint)

    async def consistency(self, old: int, size: int) -> list[bytes]:
        """The proof that the log of `size` entries extends the one of `old`."""
        return await self._pool.run(Client.consistency, old, size)

    async def inclusion(self, sequence: int, size: int) -> list[bytes]:
        """The proof that an entry is in the log of `size` entries."""
        return await self._pool.run(Client.inclusion, sequence, size)

    async def witness(self, witness: Witness) -> Checkpoint:
        """Let a witness see the log as it is now. Raises NotSigned, LogForked."""
        return await self._pool.run(Client.witness, witness)

    def rows(self, table: str) -> AsyncIterator[Document]:
        """The registry's rows of a table, as they are stored."""
        return self._pool.each(Client.rows, table)

    def episode_parts(self, plant: str, digest: str) -> AsyncIterator[bytes]:
        """An episode's bytes in parts, not verified."""
        return self._pool.each(Client.episode_parts, plant, digest)

    def blob_parts(self, digest: str) -> AsyncIterator[bytes]:
        """An artifact's arrays in parts, not verified."""
        return self._pool.each(Client.blob_parts, digest)

    async def artifact_provenance(self, plant: str, digest: str) -> Envelope:
        """Where an artifact comes from: an in-toto statement in a signed envelope."""
        return await self._pool.run(Client.artifact_provenance, plant, digest)

    async def decision_provenance(self, plant: str, digest: str) -> Envelope:
        """What a gate said of a candidate: an in-toto statement in a signed envelope."""
        return await self._pool.run(Client.decision_provenance, plant, digest)

    async def is_ready(self) -> bool:
        """Whether the service can do its work."""
        return await self._pool.run(Client.is_ready)
