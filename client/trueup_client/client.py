"""The client: every noun of the service, typed, with progress where one waits."""

from __future__ import annotations

import base64
import hashlib
import json
import os
import time
import uuid
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, BinaryIO
from urllib.parse import quote, urlencode

from trueup_client.connection import STREAM_BYTES, Connection
from trueup_client.problem import DigestMismatch, Problem, Unreachable
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

DEFAULT_URL = "http://127.0.0.1:8321"
FINAL = ("succeeded", "failed", "cancelled")
JOB_LOOK_S = 0.1
FIRST_PAUSE_S, LONGEST_PAUSE_S = 0.2, 5.0
NOT_MODIFIED = 304
IN_PARTS_FROM_BYTES = 32 << 20
ATTEMPTS = 5  # of a part, none of which comes through
Share = Callable[[float], None]


def silent(_: float) -> None:
    """Progress that nobody looks at."""


class Client:
    """Talks to one service. Not for several threads at once: give each its own.

    `url` is its address (default: TRUEUP_URL, else this machine's), `token` says who asks (default:
    TRUEUP_TOKEN), and `actor` stands in the audit log behind the token's name. Refusals raise
    Problem, silence raises Unreachable.
    """

    def __init__(
        self,
        url: str | None = None,
        actor: str | None = None,
        timeout_s: float = 120.0,
        token: str | None = None,
    ) -> None:
        address = url or os.environ.get("TRUEUP_URL") or DEFAULT_URL
        self._to = Connection(address, actor, timeout_s, token or os.environ.get("TRUEUP_TOKEN"))

    def __enter__(self) -> Client:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the connection."""
        self._to.close()

    def abort(self) -> None:
        """Close the connection for good, from another thread: what is on its way ends with
        Unreachable, and nothing is asked again."""
        self._to.abort()

    @property
    def aborted(self) -> bool:
        """Whether it was closed for good."""
        return self._to.aborted

    # -- plants and episodes

    def register_plant(self, document: Document, project: str | None = None) -> Plant:
        """Register a plant by the content of its plant.json; registering it again changes
        nothing."""
        return self._post(
            f"/v1/plants?{urlencode({'project': project})}" if project else "/v1/plants", document
        )

    def plant(self, name: str) -> Plant:
        return self._get(f"/v1/plants/{_name(name)}")

    def plants(self) -> Iterator[Plant]:
        return self._pages("/v1/plants", "after")

    def upload_episode(
        self, plant: str, path: str | os.PathLike[str], progress: Share = silent
    ) -> Episode:
        """Upload an MCAP file, streamed, with its digest; the same file again is the same episode.

        A long one goes in parts: where the line breaks it goes on from what came, in this call or
        the next.
        """
        digest = _digest_of(path)
        if os.path.getsize(path) > IN_PARTS_FROM_BYTES:
            return self._upload_in_parts(
                f"/v1/plants/{_name(plant)}/uploads/{digest}", Path(path), progress
            )
        headers = {
            "Content-Digest": _content_digest(digest),
            "Content-Length": str(os.path.getsize(path)),
            "Content-Type": "application/octet-stream",
            "Idempotency-Key": digest,
        }
        return self._send(
            "POST", f"/v1/plants/{_name(plant)}/episodes", lambda: _Watched(path, progress), headers
        )

    def _upload_in_parts(self, path: str, file: Path, progress: Share) -> Episode:
        """Send what is missing, then finish. Raises Unreachable once no part comes through any
        more."""
        size, failed = file.stat().st_size, 0
        while (offset := self._get(path)["offset_bytes"]) < size:
            headers = {
                "Upload-Offset": str(offset),
                "Content-Length": str(size - offset),
                "Content-Type": "application/octet-stream",
            }
            try:
                self._to.once("PATCH", path, _Watched(file, progress, offset), headers)
            except (Unreachable, Problem) as error:
                if isinstance(error, Problem) and error.code != "upload-offset":
                    raise
                came = self._get(path)["offset_bytes"] > offset
                failed = 0 if came else failed + 1
                if failed == ATTEMPTS:
                    raise
                time.sleep(FIRST_PAUSE_S * failed)
        progress(1.0)
        return self._post(f"{path}/finish", None)

    def episodes(self, plant: str, role: str | None = None) -> Iterator[Episode]:
        return self._pages(
            f"/v1/plants/{_name(plant)}/episodes", "after", **({"role": role} if role else {})
        )

    def episode(self, plant: str, digest: str) -> EpisodeContext:
        """An episode, with what was serving while it was recorded."""
        return self._get(f"/v1/plants/{_name(plant)}/episodes/{_name(digest)}")

    def download_episode(self, plant: str, digest: str, path: str | os.PathLike[str]) -> None:
        """Save an episode's bytes. Raises DigestMismatch if they are not what the digest names."""
        self._save(
            f"/v1/plants/{_name(plant)}/episodes/{_name(digest)}/content", digest, Path(path)
        )

    # -- artifacts, gates, jobs, decisions

    def artifacts(self, plant: str) -> Iterator[Artifact]:
        return self._pages(f"/v1/plants/{_name(plant)}/artifacts", "after")

    def artifact(self, plant: str, digest: str) -> Artifact:
        return self._get(f"/v1/plants/{_name(plant)}/artifacts/{_name(digest)}")

    def manifest_digest(self, plant: str, digest: str) -> str:
        """SHA-256 of the manifest that the service keeps under this digest."""
        return hashlib.sha256(
            self._to.whole(
                "GET", f"/v1/plants/{_name(plant)}/artifacts/{_name(digest)}/manifest", lambda: None
            )
        ).hexdigest()

    def version(self, plant: str, version: int) -> Artifact:
        return self._get(f"/v1/plants/{_name(plant)}/versions/{_name(version)}")

    def add_artifact(self, plant: str, manifest: bytes, arrays: bytes = b"") -> Artifact:
        """Add a version: first its arrays under their digest, then the manifest's exact bytes."""
        if arrays:
            self._to.whole(
                "PUT",
                f"/v1/blobs/{hashlib.sha256(arrays).hexdigest()}",
                lambda: arrays,
                {"Content-Type": "application/octet-stream"},
            )
        headers = {
            "Content-Type": "application/json",
            "Idempotency-Key": hashlib.sha256(manifest).hexdigest(),
        }
        return self._send("POST", f"/v1/plants/{_name(plant)}/artifacts", lambda: manifest, headers)

    def fetch(self, plant: str, digest: str, folder: str | os.PathLike[str]) -> Path:
        """Fetch an artifact into a folder as manifest.json and arrays.safetensors, every byte
        verified. Raises DigestMismatch."""
        to = Path(folder)
        to.mkdir(parents=True, exist_ok=True)
        self._save(
            f"/v1/plants/{_name(plant)}/artifacts/{_name(digest)}/manifest",
            digest,
            to / "manifest.json",
        )
        (to / "arrays.safetensors").unlink(missing_ok=True)
        arrays = arrays_of(to / "manifest.json")
        if arrays is not None:
            self._save(
                f"/v1/plants/{_name(plant)}/artifacts/{_name(digest)}/arrays",
                arrays,
                to / "arrays.safetensors",
            )
        return to

    def declare_gate(self, plant: str, document: Document | None = None) -> Gate:
        """Declare a gate before anything is scored by it; without a document the one in force, or
        where there is none the default.

        Once a candidate was judged, another gate names the one in force in `follows` and says why
        in `because`.
        """
        return self._post(f"/v1/plants/{_name(plant)}/gates", document)

    def gate_in_force(self, plant: str) -> GateInLine:
        """The gate that judges, and what is looser in it than in the one before."""
        return self._get(f"/v1/plants/{_name(plant)}/gate")

    def gate_in_line(self, plant: str, digest: str) -> GateInLine:
        """A gate, whether it is in force, and what is looser in it than in the one before."""
        return self._get(f"/v1/plants/{_name(plant)}/gates/{_name(digest)}/line")

    def gates(self, plant: str) -> Iterator[Gate]:
        """Every gate of a plant, by digest."""
        return self._pages(f"/v1/plants/{_name(plant)}/gates", "after")

    def gate(self, plant: str, digest: str) -> Gate:
        return self._get(f"/v1/plants/{_name(plant)}/gates/{_name(digest)}")

    def submit(self, plant: str, request: Document, key: str | None = None) -> Job:
        """Submit a job, such as {"kind": "fit", "method": "identify"} or {"kind": "gate",
        "candidate": …, "gate": …}.

        With a `key` of your own the same request is the same job, also from another process, for as
        long as the service remembers keys.
        """
        return self._post(f"/v1/plants/{_name(plant)}/jobs", request, key)

    def jobs(self, plant: str) -> Iterator[Job]:
        """Jobs of a plant, the newest first."""
        return self._pages(f"/v1/plants/{_name(plant)}/jobs", "before")

    def job(self, job: str) -> JobWithReads:
        return self._get(f"/v1/jobs/{_name(job)}")

    def wait(
        self, job: str, progress: Callable[[JobWithReads], None] = lambda _: None
    ) -> JobWithReads:
        """The job once it is final, `progress` called with it meanwhile. Raises Problem if it
        failed or was cancelled."""
        while True:
            found = self.job(job)
            progress(found)
            if found["state"] in FINAL:
                break
            time.sleep(JOB_LOOK_S)
        if found["state"] != "succeeded":
            raise Problem(
                0,
                found["result"]["problem"]
                if found["result"] and "problem" in found["result"]
                else {"code": found["state"], "detail": f"job {job} was {found['state']}"},
            )
        return found

    def cancel(self, job: str) -> Job:
        return self._post(f"/v1/jobs/{_name(job)}/cancel", None)

    def decisions(self, plant: str) -> Iterator[Decision]:
        return self._pages(f"/v1/plants/{_name(plant)}/decisions", "before")

    def decision(self, plant: str, digest: str) -> Decision:
        return self._get(f"/v1/plants/{_name(plant)}/decisions/{_name(digest)}")

    def approve(self, plant: str, decision: str, because: str | None = None) -> Approval:
        """Approve a decision, where a promotion takes two people; of a candidate that was rejected
        before it takes a reason."""
        given = None if because is None else {"because": because}
        return self._post(f"/v1/plants/{_name(plant)}/decisions/{_name(decision)}/approvals", given)

    def find_decision(self, digest: str) -> Decision:
        """A decision of whichever plant."""
        return self._get(f"/v1/decisions/{_name(digest)}")

    # -- serving

    def serving(self, plant: str) -> Serving:
        """What serves now."""
        return Serving(**self._get(f"/v1/plants/{_name(plant)}/serving"))

    def watch(
        self, plant: str, wait_s: float = 30.0, confirmed: Callable[[], None] = lambda: None
    ) -> Iterator[Serving]:
        """What serves now, then again at each move, for ever; each look waits up to `wait_s` [s] at
        the service.

        A service that is away is asked again, ever less often; the watch goes on where it was.
        `confirmed` is called at every answer, also where nothing has changed. Raises Problem for a
        refusal.
        """
        return (
            Serving(**found)
            for found in self._watched(f"/v1/plants/{_name(plant)}/serving", wait_s, confirmed)
        )

    def watch_channel(
        self,
        plant: str,
        channel: str,
        wait_s: float = 30.0,
        confirmed: Callable[[], None] = lambda: None,
    ) -> Iterator[ChannelPosition]:
        """The same of a channel, which must have served something."""
        return self._watched(
            f"/v1/plants/{_name(plant)}/channels/{_name(channel)}/serving", wait_s, confirmed
        )

    def history(self, plant: str) -> Iterator[Serving]:
        """Every position of the pointer, in order."""
        return (
            Serving(**item)
            for item in self._pages(f"/v1/plants/{_name(plant)}/serving/history", "after")
        )

    def served_at(self, plant: str, at: str) -> Serving | None:
        """What was live at a time: UTC, ISO 8601, ending in Z."""
        items = self._get(f"/v1/plants/{_name(plant)}/serving/history?{urlencode({'at': at})}")[
            "items"
        ]
        return Serving(**items[0]) if items else None

    def promote(
        self, plant: str, decision: str, expected_generation: int, key: str | None = None
    ) -> Serving:
        """Serve the candidate of an accepted decision, if the pointer has not moved since; once
        under a `key` of your own."""
        wanted = {"decision": decision, "expected_generation": expected_generation}
        return Serving(**self._post(f"/v1/plants/{_name(plant)}/serving/promote", wanted, key))

    def roll_back(self, plant: str, expected_generation: int, key: str | None = None) -> Serving:
        """Serve what served before, after its switchback test; once under a `key` of your own."""
        return Serving(
            **self._post(
                f"/v1/plants/{_name(plant)}/serving/rollback",
                {"expected_generation": expected_generation},
                key,
            )
        )

    def serving_envelope(self, plant: str) -> Envelope:
        """What serves, signed: `Robot` verifies it."""
        return self._get(f"/v1/plants/{_name(plant)}/serving/envelope")

    # -- evidence and channels

    def add_evidence(self, plant: str, document: Document) -> Evidence:
        """Add what was found of an artifact at a stage: artifact, stage, passed, shows,
        cannot_show, figures."""
        return self._post(
            f"/v1/plants/{_name(plant)}/evidence", {"schema": "trueup.evidence/1", **document}
        )

    def evidence(self, plant: str, artifact: str) -> list[Evidence]:
        """Everything that was found of an artifact, in order."""
        items: list[Evidence] = list(
            self._pages(f"/v1/plants/{_name(plant)}/artifacts/{_name(artifact)}/evidence", "after")
        )
        return items

    def declare_channel(self, plant: str, name: str, requires: list[str]) -> Channel:
        """Declare a channel of serving that requires passed evidence of these stages."""
        return self._post(
            f"/v1/plants/{_name(plant)}/channels", {"name": name, "requires": requires}
        )

    def channels(self, plant: str) -> Iterator[Channel]:
        return self._pages(f"/v1/plants/{_name(plant)}/channels", "after")

    def channel_serving(self, plant: str, channel: str) -> ChannelPosition:
        """What a channel serves now."""
        return self._get(f"/v1/plants/{_name(plant)}/channels/{_name(channel)}/serving")

    def move_channel(
        self, plant: str, channel: str, artifact: str, expected_generation: int
    ) -> ChannelPosition:
        """Serve an artifact on a channel, if the channel has not moved since; its first move
        expects generation 0."""
        wanted = {"artifact": artifact, "expected_generation": expected_generation}
        return self._post(f"/v1/plants/{_name(plant)}/channels/{_name(channel)}/move", wanted)

    # -- monitoring

    def declare_policy(self, plant: str, document: Document) -> Policy:
        """Declare what may happen without a person; it holds from then on."""
        return self._post(f"/v1/plants/{_name(plant)}/policies", document)

    def policy(self, plant: str) -> Policy:
        """The update policy that holds."""
        return self._get(f"/v1/plants/{_name(plant)}/policy")

    def send_telemetry(self, plant: str, batch: Document) -> Episode:
        """Send a live batch: `start_ns` as text, `t_s`, `observations` and `commands` by channel;
        it becomes an episode that is watched."""
        return self._post(f"/v1/plants/{_name(plant)}/telemetry", batch)

    def monitor(self, plant: str) -> MonitorState:
        """Whether the model that serves is watched, and the alarm that is open."""
        return self._get(f"/v1/plants/{_name(plant)}/monitor")

    def monitors(self, plant: str) -> Iterator[Monitor]:
        """Every monitor there was, the newest first, each with its calibration."""
        return self._pages(f"/v1/plants/{_name(plant)}/monitors", "before")

    def watches(self, plant: str, monitor: str) -> Iterator[Watch]:
        """What a monitor saw, episode by episode."""
        return self._pages(f"/v1/plants/{_name(plant)}/monitors/{_name(monitor)}/watches", "after")

    def alarms(self, plant: str) -> Iterator[Alarm]:
        """Every alarm, the newest first."""
        return self._pages(f"/v1/plants/{_name(plant)}/alarms", "before")

    def alarm(self, plant: str, alarm: str) -> Alarm:
        return self._get(f"/v1/plants/{_name(plant)}/alarms/{_name(alarm)}")

    def close_alarm(self, plant: str, alarm: str, because: str) -> Alarm:
        """Close an alarm, and say why; the next one may then be raised."""
        return self._post(
            f"/v1/plants/{_name(plant)}/alarms/{_name(alarm)}/close", {"because": because}
        )

    # -- access

    def whoami(self) -> Identity:
        """Whom the service takes this client for: name, roles, project, plant."""
        return self._get("/v1/session")

    def create_project(self, name: str) -> Project:
        return self._post("/v1/projects", {"name": name})

    def projects(self) -> Iterator[Project]:
        return self._pages("/v1/projects", "after")

    def issue_token(
        self,
        name: str,
        roles: list[str],
        project: str | None = None,
        plant: str | None = None,
        days: float | None = 365.0,
    ) -> IssuedToken:
        """Issue a token; `token` of the answer is shown this once. Not repeated where the answer
        was lost: revoke it, issue another."""
        wanted = {"name": name, "roles": roles, "project": project, "plant": plant, "days": days}
        sent = {"Content-Type": "application/json"}
        return json.loads(self._to.once("POST", "/v1/tokens", json.dumps(wanted).encode(), sent))

    def tokens(self) -> Iterator[Token]:
        return self._pages("/v1/tokens", "after")

    def revoke_token(self, prefix: str) -> Token:
        """Revoke a token, for good."""
        return self._post(f"/v1/tokens/{_name(prefix)}/revoke", None)

    # -- audit

    def audit(self, plant: str | None = None, after: int = 0) -> Iterator[AuditEntry]:
        """Every entry of the log, in order, from behind one."""
        return self._pages(
            "/v1/audit", "after", after=str(after), **({"plant": plant} if plant else {})
        )

    def audit_key(self) -> str:
        """The log's public key, as the service gives it: keep it."""
        return self._to.whole("GET", "/v1/audit/key", lambda: None).decode().strip()

    def endorsements(self) -> list[str]:
        """The notes by which keys of the log handed over to the next, in order."""
        return [
            key["endorsement"] for key in self._get("/v1/audit/keys")["items"] if key["endorsement"]
        ]

    def checkpoint(self) -> str:
        """The log's signed head, as a note."""
        return self._to.whole("GET", "/v1/audit/checkpoint", lambda: None).decode()

    def consistency(self, old: int, size: int) -> list[bytes]:
        """The proof that the log of `size` entries extends the one of `old`."""
        return _hashes(self._get(f"/v1/audit/consistency?{urlencode({'old': old, 'size': size})}"))

    def inclusion(self, sequence: int, size: int) -> list[bytes]:
        """The proof that an entry is in the log of `size` entries."""
        return _hashes(
            self._get(f"/v1/audit/inclusion?{urlencode({'sequence': sequence, 'size': size})}")
        )

    def witness(self, witness: Witness) -> Checkpoint:
        """Let a witness see the log as it is now. Raises NotSigned, LogForked."""
        if witness.key is None:
            witness.pin(self.audit_key())
        return witness.see(self.checkpoint(), self.consistency, self.endorsements)

    def rows(self, table: str) -> Iterator[Document]:
        """The registry's rows of a table, as they are stored."""
        return self._pages(f"/v1/audit/rows/{_name(table)}", "after", limit="1000")

    def episode_parts(self, plant: str, digest: str) -> Iterator[bytes]:
        """An episode's bytes in parts, not verified."""
        return self._to.parts(f"/v1/plants/{_name(plant)}/episodes/{_name(digest)}/content")

    def blob_parts(self, digest: str) -> Iterator[bytes]:
        """An artifact's arrays in parts, not verified."""
        return self._to.parts(f"/v1/blobs/{_name(digest)}")

    def artifact_provenance(self, plant: str, digest: str) -> Envelope:
        """Where an artifact comes from: an in-toto statement in a signed envelope."""
        return self._get(f"/v1/plants/{_name(plant)}/artifacts/{_name(digest)}/provenance")

    def decision_provenance(self, plant: str, digest: str) -> Envelope:
        """What a gate said of a candidate: an in-toto statement in a signed envelope."""
        return self._get(f"/v1/plants/{_name(plant)}/decisions/{_name(digest)}/provenance")

    def is_ready(self) -> bool:
        """Whether the service can do its work."""
        try:
            return bool(self._get("/readyz")["ready"])
        except Problem:
            return False

    # -- how

    def _get(self, path: str) -> Any:
        return self._to.json("GET", path)

    def _post(self, path: str, body: Document | None, key: str | None = None) -> Any:
        return self._to.json("POST", path, body, {"Idempotency-Key": key or uuid.uuid4().hex})

    def _watched(self, path: str, wait_s: float, confirmed: Callable[[], None]) -> Iterator[Any]:
        tag, pause_s = "", FIRST_PAUSE_S
        while True:
            try:
                headers = {"If-None-Match": tag} if tag else {}
                status, answered, body = self._to.tagged(
                    "GET", f"{path}?wait_s={wait_s:g}", lambda: None, headers
                )
            except Unreachable:
                if self._to.aborted:
                    raise
                time.sleep(pause_s)
                pause_s = min(2.0 * pause_s, LONGEST_PAUSE_S)
                continue
            pause_s = FIRST_PAUSE_S
            confirmed()
            if status != NOT_MODIFIED:
                tag = answered["ETag"]
                yield json.loads(body)

    def _send(
        self, method: str, path: str, body: Callable[[], bytes | _Watched], headers: dict[str, str]
    ) -> Any:
        return json.loads(self._to.whole(method, path, body, headers))

    def _pages(self, path: str, cursor: str, **query: str) -> Iterator[Any]:
        followed: set[str] = set()
        while True:
            page = self._get(f"{path}?{urlencode(query)}")
            yield from page["items"]
            if page["next"] is None:
                return
            query[cursor] = page["next"]
            if query[cursor] in followed:
                raise DigestMismatch(
                    f"the pages of {path} lead back to one that was read: a list has an end"
                )
            followed.add(query[cursor])

    def _save(self, path: str, digest: str, to: Path) -> None:
        """Write beside, verify, then rename: no half or wrong file ever has the name."""
        beside, hashed = to.with_name(f"{to.name}.{uuid.uuid4().hex}.part"), hashlib.sha256()
        try:
            with beside.open("wb") as file:
                for part in self._to.parts(path):
                    hashed.update(part)
                    file.write(part)
                file.flush()
                os.fsync(file.fileno())
            if hashed.hexdigest() != digest:
                raise DigestMismatch(f"{path} gave {hashed.hexdigest()}")
            beside.replace(to)
            sync_folder(to.parent)
        finally:
            beside.unlink(missing_ok=True)


def sync_folder(folder: Path) -> None:
    """Make the names in a folder durable."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


class _Watched:
    """A file that tells how much of it has been read."""

    def __init__(self, path: str | os.PathLike[str], progress: Share, offset: int = 0) -> None:
        self._file: BinaryIO = open(path, "rb")  # noqa: SIM115  (closed by whoever sends it)
        self._file.seek(offset)
        self._size, self._progress = max(os.path.getsize(path), 1), progress

    def read(self, length: int = STREAM_BYTES) -> bytes:
        part = self._file.read(max(length, STREAM_BYTES))
        self._progress(self._file.tell() / self._size)
        return part

    def close(self) -> None:
        self._file.close()


def arrays_of(manifest: Path) -> str | None:
    """The digest of the arrays that a manifest, whose own digest holds, names; None where it has
    none."""
    named = json.loads(manifest.read_bytes())["arrays"]
    return None if named is None else str(named["sha256"])


def is_whole(folder: Path, digest: str) -> bool:
    """Whether a fetched artifact is on disk as its digest names it, arrays included."""
    manifest = folder / "manifest.json"
    if not manifest.is_file() or _digest_of(manifest) != digest:
        return False
    arrays = arrays_of(manifest)
    kept = folder / "arrays.safetensors"
    return not kept.exists() if arrays is None else kept.is_file() and _digest_of(kept) == arrays


def _digest_of(path: str | os.PathLike[str]) -> str:
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _content_digest(digest: str) -> str:
    return f"sha-256=:{base64.b64encode(bytes.fromhex(digest)).decode()}:"


def _hashes(proof: Document) -> list[bytes]:
    return [base64.b64decode(h) for h in proof["hashes"]]


def _name(part: object) -> str:
    """A name as one segment of a path, whatever it holds."""
    return quote(str(part), safe="")
